"""The thesis' results table: which representation holds where the motion is another one than in training.

`rows` says what is compared, `data` reads the recordings, `run` trains and tests one network, `results` brings
the runs together, `report` prints them, `command` is `async-tnt table`. Needs the extra `train` (torch).
"""
