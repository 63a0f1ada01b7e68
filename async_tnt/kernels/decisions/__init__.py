"""Compiled code that says when a decision is due, and what it is."""
