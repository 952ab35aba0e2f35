"""From a Drake plant or written equations to symbolic dynamics to a compiled step, Jacobian and bounds."""
