"""Classify what an event camera sees, event by event, with the Temporal Normalization Transform."""
