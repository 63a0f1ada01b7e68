"""Batch definitions of what `async_tnt` computes event by event: short, in torch, differentiable.

Nothing here imports anything of `async_tnt`, or shares code with it: the two are held against each other.
Start with `volume.py` (the event volume), then `transform.py` and `landmarks.py` (the Temporal
Normalization Transform), then `networks.py`.
"""

from .landmarks import fitted_flow, landmark
from .networks import Classifier, LandmarkRegressor, Pipeline
from .transform import TNTCoordinates, tnt_coordinates
from .volume import event_volume, tnt_volume

__all__ = [
    "Classifier",
    "LandmarkRegressor",
    "Pipeline",
    "TNTCoordinates",
    "event_volume",
    "fitted_flow",
    "landmark",
    "tnt_coordinates",
    "tnt_volume",
]
