"""The laboratory: measurements, comparisons, the figures and tables of the pages.

Not part of the installed package.
"""
