"""Motion re-synthesis: the events that a recorded object would have given under another motion.

From the events of a window follow the path on which an image moved, and this image (`paths`,
`moving_image`). The image is moved on another path, and its events are simulated
(`reconstruction`), by pixels that are found with `calibration`.

`async-tnt train` uses it, if its motions are to be re-synthesized. No name of it is public.
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
