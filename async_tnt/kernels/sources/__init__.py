"""Compiled code for words of files and datagrams, clocks, and pixels."""
