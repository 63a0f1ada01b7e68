"""Train a classifier on recordings. Needs the extra `train` (torch).

`windows` and `simulated` hold the data, `augment` varies it, `batches` makes volumes of it, `train` learns
from them, `evaluate` says how well, `command` is `async-tnt train`.
"""
