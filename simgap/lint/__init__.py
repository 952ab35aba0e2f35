"""Checks of `simgap check`, before anything long runs; one family a file."""
