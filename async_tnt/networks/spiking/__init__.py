"""Spiking networks: their layers, compiled programs, and volumes with neurons."""
