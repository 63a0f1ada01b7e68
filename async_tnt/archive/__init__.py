"""Archives of thousands of recordings, streamed by several processes or machines into one file; resumable.

`run_recording` and `evaluate_recording` make a record of one recording, a plain dict. An `Executor` runs them on many.
`collect` writes the records to the result file, as the only process.
"""
