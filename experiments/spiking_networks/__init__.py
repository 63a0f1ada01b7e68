"""Spiking networks in several programs: the same graph, event by event and in time steps."""
