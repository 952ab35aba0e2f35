"""From samples to a bound: programs, paddings, conformal widths, and the check on fresh samples."""
