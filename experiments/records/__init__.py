"""Results in `experiments/results`: numbers, and the run that made them."""
