"""Simulate an event camera in front of a moving picture. Needs no torch."""

from async_tnt.simulation.simulator import PixelModel, simulate

TYPE_CHECKING = False
if not TYPE_CHECKING:  # type checkers would let every name pass
    # public names of version 0.2 -> their modules
    _INTERNAL = {
        "Picture": "pictures",
        "SceneSettings": "picture_scene",
        "record_picture": "picture_scene",
    }

    def __getattr__(name):
        if name in _INTERNAL:
            raise AttributeError(
                f"async_tnt.simulation.{name} is no longer public: `async-tnt train PICTURES` "
                f"trains with it, and async_tnt.simulation.{_INTERNAL[name]} has it"
            )
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = ["PixelModel", "simulate"]
