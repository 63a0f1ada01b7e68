"""Event cameras as sources of packets: `open_camera`. Needs the extra `cameras`, see docs/cameras.md."""

from .camera import Camera, CameraCounts
from .opening import DRIVERS, open_camera

__all__ = ["DRIVERS", "Camera", "CameraCounts", "open_camera"]
