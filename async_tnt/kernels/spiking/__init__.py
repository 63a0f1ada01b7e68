"""Spiking networks: each event goes through all layers at its own time."""
