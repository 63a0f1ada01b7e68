"""Motion re-synthesis: the events that a recorded object would have given under another motion.

From the events of a window follow the path on which an image moved, and this image (`paths`,
`moving_image`). The image is moved on another path, and its events are simulated
(`reconstruction`), by pixels that are found with `calibration`.
"""

from async_tnt.resynthesis.calibration import Calibration, calibrate
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.reconstruction import MovedImage, Reconstruction, SimulatedPixels

__all__ = [
    "Calibration",
    "MotionPath",
    "MovedImage",
    "Reconstruction",
    "SimulatedPixels",
    "calibrate",
]
