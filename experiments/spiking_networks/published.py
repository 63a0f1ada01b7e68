"""What was published of the NIR paper's network for N-MNIST."""

PUBLISHED = {
    "sinabs": 0.9847,
    "SpiNNaker2": 0.982,
    "Lava": 0.9815,
    "Norse": 0.9811,
    "Nengo": 0.9811,
    "snnTorch": 0.9785,
    "Spyx": 0.971,
    "Speck": 0.954,
}
"""Platform -> accuracy in the NIR paper, on the official test.

Pedersen et al. 2024, Neuromorphic intermediate representation: A unified instruction set for
interoperable brain-inspired computing, Nature Communications 15, 8122, table of the N-MNIST
network. No program here measured these numbers.
"""
