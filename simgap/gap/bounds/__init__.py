"""The gap function: what bounds it, in every form that it takes, and its ranges over boxes."""
