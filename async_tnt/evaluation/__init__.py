"""Evaluate thousands of recordings in several processes, and write one result file.

The processes may be on several machines. An evaluation that was interrupted can be resumed.

`evaluate_recording` makes the record of one recording: a plain dict. `run_all` and `run_on_dask`
call it for many recordings. `collect` takes the records, and alone writes them to the result file.
`async-tnt evaluate` uses these functions; none of their names is public.
"""
