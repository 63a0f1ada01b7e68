"""Motion re-synthesis: the events that a recorded object would have given under another motion.

The events of a window tell the path on which an image moved (module `paths`), and the image itself
(`moving_image`). Then the image is moved on another path, and its events are simulated
(`reconstruction`). The module `calibration` finds the parameters of the simulated pixels.

`async-tnt train` uses this package if it is asked for re-synthesized motions. None of the package's
names is public.
"""

TYPE_CHECKING = False
if not TYPE_CHECKING:  # type checkers would let every name pass
    from async_tnt.base.package import lazy_names

    __getattr__, __dir__ = lazy_names(
        globals(),
        {},
        instead={
            "Calibration": "it is in `async_tnt.resynthesis.calibration`",
            "MotionPath": "it is in `async_tnt.resynthesis.paths`",
            "MovedImage": "it is in `async_tnt.resynthesis.reconstruction`",
            "Reconstruction": "it is in `async_tnt.resynthesis.reconstruction`",
            "SimulatedPixels": "it is in `async_tnt.resynthesis.reconstruction`",
            "calibrate": "it is in `async_tnt.resynthesis.calibration`",
        },
    )
