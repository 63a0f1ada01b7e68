"""Evaluate thousands of recordings, by several processes or machines, into one result file.

An evaluation that was interrupted can be resumed.

`evaluate_recording` makes a record of one recording, a plain dict. `run_all` and `run_on_dask` call
it for many. `collect` writes the records to the result file, as the only process. `async-tnt
evaluate` uses them; none of these names is public.
"""
