"""Networks as data: operations with their shapes, and the steps of a compiled program."""
