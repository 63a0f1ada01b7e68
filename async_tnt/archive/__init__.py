"""Archives of thousands of recordings: streamed by several processes or machines, into one file, resumable.

The function of one recording (`run_recording`, `evaluate_recording`) makes a record of it, a plain dict. `Place` says
where the functions run. `collect` keeps the records in a journal and makes the result file of it; it alone writes.
"""
