"""Simulate an event camera in front of a moving picture. This needs no torch."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from async_tnt.simulation.simulator import PixelModel, simulate
else:
    from async_tnt.base.package import lazy_names

    __getattr__, __dir__ = lazy_names(
        globals(),
        {"simulator": "PixelModel simulate"},
        instead={
            "Picture": "it is in `async_tnt.simulation.pictures`",
            "SceneSettings": "it is in `async_tnt.simulation.picture_scene`",
            "record_picture": "it is in `async_tnt.simulation.picture_scene`",
        },
    )

__all__ = ["PixelModel", "simulate"]
