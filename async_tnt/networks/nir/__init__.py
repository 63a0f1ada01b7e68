"""The Neuromorphic Intermediate Representation: spiking networks of other programs."""
