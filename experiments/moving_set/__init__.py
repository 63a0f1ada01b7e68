"""N-MOVING-MNIST: a folder of simulated recordings, and its comparison with N-MNIST."""
