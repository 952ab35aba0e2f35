"""The case file: typed sections, one a module."""
