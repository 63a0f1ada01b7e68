"""Motion re-synthesis: the events that a recorded object would have given under another motion.

events of a window -> path and image -> another path -> simulated events
pixels, moving_image   paths, images    random_motions  events, calibration
"""

from async_tnt.resynthesis.calibration import Calibration, calibrate
from async_tnt.resynthesis.events import MovedImage, SimulatedPixels
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.reconstruction import Reconstruction

__all__ = ["Calibration", "MotionPath", "MovedImage", "Reconstruction", "SimulatedPixels", "calibrate"]
