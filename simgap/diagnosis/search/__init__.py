"""Which set of effects: fits, scores, selection, equivalences, transfer to other data."""
