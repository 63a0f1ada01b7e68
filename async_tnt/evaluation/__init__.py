"""Thousands of recordings, streamed by several processes or machines into one result file;
resumable.

`evaluate_recording` makes a record of one recording, a plain dict. `run_all` and `run_on_dask` call
it for many. `collect` writes the records to the result file, as the only process.
"""
