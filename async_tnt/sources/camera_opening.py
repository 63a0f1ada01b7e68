"""Cameras by name: `camera`, `camera:KIND`, `camera:KIND:SERIAL`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping

from async_tnt.sources import camera_dv as dv
from async_tnt.sources import camera_neuromorphic as neuromorphic
from async_tnt.sources.camera import Camera
from async_tnt.sources.camera_device import Driver, FoundCamera, first_line, is_failure

DRIVERS: Mapping[str, Callable[[], Driver]] = {
    "neuromorphic-drivers": neuromorphic.neuromorphic_drivers,
    "dv-processing": dv.dv_processing,
}
"""What makes each library's `Driver`, or raises ImportError where it is not installed. They are asked in this order:
the first one waits for events without polling, and counts what is lost."""

SIZES = {"davis346": (346, 260)}  # dv-processing tells DAVIS cameras apart only when they are open

ALL_KINDS = sorted({kind for kinds in (*neuromorphic.KINDS.values(), *dv.KINDS.values()) for kind in kinds})


def open_camera(name: str = "camera", *, drivers: Mapping[str, Callable[[], Driver]] = DRIVERS) -> Camera:
    """Open a camera.

    Parameters
    ----------
    name : `camera` (the first one found), `camera:KIND` (evk4, evk3, davis346, dvxplorer, ...) or
        `camera:KIND:SERIAL`.
    drivers : the libraries that look, in this order, by name; what stands here is called once. Tests put others.

    Returns
    -------
    Camera, which runs already: read it, or its driver's buffer overflows.

    Raises
    ------
    ValueError : no such kind of camera.
    OSError : no such camera is connected, or it cannot be opened; the message says who looked and what to check.
    ImportError : no library is installed.
    """
    kind, serial = parse_camera_name(name)
    missing, absent, wrong = [], [], []
    in_vain = []  # looked, and there is nothing to say of it
    is_there = False
    for package, make_driver in drivers.items():
        try:
            driver = make_driver()
        except ImportError as error:
            missing.append(package)
            if isinstance(error, ModuleNotFoundError):
                absent.append(package)
            else:  # it is there, but does not load
                wrong.append(f"{package} does not load: {first_line(error)}")
            continue
        try:
            found = driver.find()
        except BaseException as error:
            if not is_failure(error):
                raise
            wrong.append(f"{driver.name} cannot look: {first_line(error)} (no USB here?)")
            continue
        if not found:
            in_vain.append(driver.name)
        for camera in found:
            if not _is_meant(camera, kind, serial):
                wrong.append(f"{driver.name} found {camera}, which is not meant")
                continue
            try:
                device = camera.open()
            except BaseException as error:
                if not is_failure(error):
                    raise
                is_there = True
                wrong.append(f"{driver.name} found {camera} but cannot open it: {camera.problem or first_line(error)}")
                continue
            opened = Camera(device, f"{camera} by {driver.name}")
            if kind not in SIZES or opened.sensor == SIZES[kind]:
                return opened
            opened.close()
            wrong.append(f"{driver.name} found {camera}, which has {opened.sensor[0]}x{opened.sensor[1]} pixels")
    if len(missing) == len(drivers):
        detail = f" ({'; '.join(wrong)})" if wrong else ""
        raise ImportError(
            f"{name}: cameras are read by {' or '.join(missing)}, which are missing: pip install '.[cameras]'{detail}"
        )
    said = ["cannot be opened" if is_there else "no camera found"]
    if in_vain:
        said.append(f"{' and '.join(in_vain)} looked")
    said += wrong
    if absent:
        said.append(f"{', '.join(absent)}: not installed")
    raise OSError(f"{name}: {'; '.join(said)}. {_advice()}")


def parse_camera_name(name: str) -> tuple[str | None, str | None]:
    """(kind, serial), None for any.

    Examples
    --------
    >>> parse_camera_name("camera"), parse_camera_name("camera:EVK4"), parse_camera_name("camera:davis346:00000042")
    ((None, None), ('evk4', None), ('davis346', '00000042'))
    """
    word, *rest = name.split(":", 2)
    if word != "camera" or "" in rest:
        raise ValueError(f"a camera's name is camera, camera:KIND or camera:KIND:SERIAL, got {name!r}")
    kind = rest[0].lower() if rest else None
    if kind is not None and kind not in ALL_KINDS:
        raise ValueError(f"{name}: no such kind of camera; known are {', '.join(ALL_KINDS)}")
    return kind, rest[1] if len(rest) == 2 else None


def _is_meant(camera: FoundCamera, kind: str | None, serial: str | None) -> bool:
    # one that does not tell its serial number may be the one: opening it says why
    return (kind is None or kind in camera.kinds) and (serial is None or camera.serial in (serial, None))


def _advice() -> str:
    advice = "Is it plugged in, and used by no other program?"
    if sys.platform.startswith("linux"):
        advice += " Does lsusb show it, and do udev rules let users read it (neuromorphic-drivers-install-udev-rules)?"
    return advice
