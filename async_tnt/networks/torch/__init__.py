"""Layers from torch modules."""
