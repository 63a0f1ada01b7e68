"""Compiled code for networks: what has changed, and what follows from it."""
