"""The adversary: searches for steps outside gamma, and for runs that break what a controller promises."""
