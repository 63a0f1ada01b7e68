"""A digit that is taught to a network of nine others."""
