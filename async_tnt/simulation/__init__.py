"""Simulate an event camera in front of a moving picture. Needs no torch."""

from async_tnt.simulation.picture_scene import SceneSettings, record_picture
from async_tnt.simulation.pictures import Picture
from async_tnt.simulation.simulator import PixelModel, simulate

__all__ = ["Picture", "PixelModel", "SceneSettings", "record_picture", "simulate"]
