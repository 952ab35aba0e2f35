"""Pictures, each from plain arrays to a matplotlib figure."""
