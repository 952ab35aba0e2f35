"""What `simgap check` says of a case before anything long runs, one family a file."""
