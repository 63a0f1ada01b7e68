"""Small helpers that everything shares: checks of arguments and calls, files, progress, worker
processes."""
