"""The tables and texts of RESULTS.md and of the pages, made from `results/*.json`."""
