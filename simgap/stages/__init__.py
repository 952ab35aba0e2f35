"""One thin file per stage: read, call, write."""
