"""Optical flow after every event: errors and times of the example's network and of plane fits."""
