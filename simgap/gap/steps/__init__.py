"""The road from a case to its bound, one step a file: grid, rollouts, scp, lipschitz, gap.

Each step is one function for every case. Where a simulator remembers earlier inputs the step branches here, and nowhere
above: rules, subcommands and files are the same.
"""
