"""Published networks, without their weights: a list of them, and how each is built."""
