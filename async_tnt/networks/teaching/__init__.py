"""New classes for a finished model, from statistics of the classes that it knows."""
