"""Numbers for a new case: sampling time, boxes, inputs and cells with which something is won."""
