"""Queues between a source and a consumer that may be slower."""
