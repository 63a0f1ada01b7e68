"""Batch definitions of what `async_tnt` computes event by event: short, in torch, differentiable.

This package does not import `async_tnt`, and shares no code with it: tests compare the results of
the two. Start with `volume.py` (the event volume), then `transform.py` and `landmarks.py` (the
Temporal Normalization Transform), then `networks.py`. Independent of these: `images.py`,
`motion.py`, `moving_image.py`, `objects.py`, `teaching.py`.
"""

from .images import count_image, count_timestamp_image, time_image
from .landmarks import fitted_flow, landmark
from .layers import LayerNetwork, heatmap_centroid
from .motion import move_by_flow
from .networks import Classifier, LandmarkRegressor, Pipeline
from .objects import FoundObject, ObjectNumbers, box_overlap, boxes_on_map, objects_on_map
from .teaching import taught_row
from .transform import TNTCoordinates, tnt_coordinates
from .volume import event_volume, tnt_volume
from .window import until_newest, windows_of_events

__all__ = [
    "Classifier",
    "FoundObject",
    "LandmarkRegressor",
    "LayerNetwork",
    "ObjectNumbers",
    "Pipeline",
    "TNTCoordinates",
    "box_overlap",
    "boxes_on_map",
    "count_image",
    "count_timestamp_image",
    "event_volume",
    "fitted_flow",
    "heatmap_centroid",
    "landmark",
    "move_by_flow",
    "objects_on_map",
    "taught_row",
    "time_image",
    "tnt_coordinates",
    "tnt_volume",
    "until_newest",
    "windows_of_events",
]
