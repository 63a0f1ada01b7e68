"""Motion re-synthesis: the events that a recorded object would have given under another motion.

events of a window -> path and image       -> another path -> simulated events
pixels                paths, moving_image     paths           reconstruction, calibration
"""

from async_tnt.resynthesis.calibration import Calibration, calibrate
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.pixels import SimulatedPixels
from async_tnt.resynthesis.reconstruction import MovedImage, Reconstruction

__all__ = ["Calibration", "MotionPath", "MovedImage", "Reconstruction", "SimulatedPixels", "calibrate"]
