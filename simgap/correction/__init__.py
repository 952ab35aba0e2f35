"""From a diagnosis to a case that bound and controller can be made for: the model corrected, what is left bounded."""
