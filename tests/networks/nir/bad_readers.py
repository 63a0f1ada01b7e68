"""Readers in the place of `hdf5_content._content_of`, which behave as HDF5 does with some files."""

import os
import time


def crash(path, group):
    os.abort()


def hang(path, group):
    time.sleep(60)


def fill_memory(path, group):
    return bytearray(1 << 45)
