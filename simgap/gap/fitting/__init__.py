"""From samples to a bound: programs, paddings, and the check on fresh samples."""
