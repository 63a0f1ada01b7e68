"""Motion re-synthesis: the events that a recorded object would have given under another motion.

From the events of a window follow the path on which an image moved, and this image (`paths`,
`moving_image`). The image is moved on another path, and its events are simulated
(`reconstruction`), by pixels that are found with `calibration`.

`async-tnt train` uses it, if its motions are to be re-synthesized. No name of it is public.
"""

TYPE_CHECKING = False
if not TYPE_CHECKING:  # type checkers would let every name pass
    # public names of version 0.2 -> their modules
    _INTERNAL = {
        "Calibration": "calibration",
        "calibrate": "calibration",
        "MotionPath": "paths",
        "MovedImage": "reconstruction",
        "Reconstruction": "reconstruction",
        "SimulatedPixels": "reconstruction",
    }

    def __getattr__(name):
        if name in _INTERNAL:
            raise AttributeError(
                f"async_tnt.resynthesis.{name} is no longer public: "
                "`async-tnt train` trains with it, and "
                f"async_tnt.resynthesis.{_INTERNAL[name]} has it"
            )
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
