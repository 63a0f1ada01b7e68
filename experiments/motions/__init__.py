"""Motions of images, and the simulated camera that sees digits move."""
