"""MNIST and N-MNIST: reading, writing, and windows for training."""
