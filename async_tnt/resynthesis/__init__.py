"""Motion re-synthesis: the events that a recorded object would have given under another motion.

events of a window -> path and image       -> another path -> simulated events
                      paths, moving_image                     reconstruction, calibration
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
