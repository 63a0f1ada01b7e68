"""Compiled code for simulation, re-synthesis and batches of volumes."""
