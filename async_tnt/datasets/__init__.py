"""Data sets of one's own: a folder of class folders with recordings in them, and how well a model does on one.

The layout of such a folder:

    DATASET/<class name>/<recording>              in any format that `open_recording` reads
    DATASET/Train/<class name>/<recording>        or with a folder for training and one for the final test
    DATASET/Test/<class name>/<recording>
"""

from .class_folders import find_recordings
from .scores import Scores, score_recordings

__all__ = ["Scores", "find_recordings", "score_recordings"]
