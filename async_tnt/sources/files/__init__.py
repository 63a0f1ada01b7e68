"""Recordings: `open_recording`, and a file for each format that it reads."""
