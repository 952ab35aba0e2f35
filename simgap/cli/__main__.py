"""`python -m simgap.cli`."""

from simgap.cli import main

main()
