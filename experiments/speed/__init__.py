"""Tools that measure time.

They are moments of a stream, engines to compare with, and loops that let them take turns.
"""
