"""Other representations of events: images, events moved by optical flow, recordings cut into pieces.

    count_image             events per pixel and polarity
    count_timestamp_image   the same, and when each pixel last fired
    move_by_flow            the motion model: events moved by constant optical flow; `undo_flow` moves them back
    segment                 a recording cut at given times; `split_saccades` cuts N-MNIST's, `find_pauses` finds times

The event volume, the Temporal Normalization Transform, and images that a stream keeps up to date are
`async_tnt.TNTVolume`.
"""

from async_tnt.representations.images import count_image, count_timestamp_image
from async_tnt.representations.motion import move_by_flow, undo_flow
from async_tnt.representations.saccades import SACCADE_CUTS_US, find_pauses, segment, split_saccades

__all__ = [
    "SACCADE_CUTS_US",
    "count_image",
    "count_timestamp_image",
    "find_pauses",
    "move_by_flow",
    "segment",
    "split_saccades",
    "undo_flow",
]
