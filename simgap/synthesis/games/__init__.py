"""Games on an abstraction: fixed points for what is to be held, reached, or both."""
