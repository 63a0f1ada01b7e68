"""Compiled kernels: arrays in, arrays out.

They import nothing of the package outside this folder.
"""
