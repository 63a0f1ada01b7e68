"""Compiled code for packets, landmarks and the cells of a volume."""
