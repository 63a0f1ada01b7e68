"""Pictures to train on, and digits in motions to test with."""
