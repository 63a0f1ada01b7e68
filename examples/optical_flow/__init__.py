"""Optical flow after every event: made scenes with known flow, a network, and plane fits."""
