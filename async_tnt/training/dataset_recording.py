"""One recording of a class folder: what a network is to see of it, or why it is left out."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from async_tnt.sources.class_folders import name_of
from async_tnt.sources.files.fitting import check_sensor
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import Sensor
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_selector import PixelSelector
from async_tnt.sources.sizes import by

LONGEST_US = 1 << 31  # what a column of int32 holds
DAMAGED, EMPTY, OTHER_SENSOR, UNSEEN, COPY = "damaged", "empty", "other sensor", "unseen", "copy"


@dataclass
class OwnRecording:
    """A recording on its way from its file to the network.

    Parameters
    ----------
    label : the place of its class.
    sensor : (width, height) as the recording itself says; None where it does not.
    events : None where it is left out.
    recorded : a fingerprint of its events before any is left out; b"" where there are none.
    is_selected : the events are those that the network is to see; else, all of the recording.
    n_outside, n_masked : events left out, outside of the region and of masked pixels.
    cause : why it is left out, one of the constants above; "" where it is not.
    refusal : the same in words, with its path.
    """

    path: Path
    label: int
    sensor: Sensor | None = None
    events: np.ndarray | None = None
    recorded: bytes = b""
    is_selected: bool = False
    n_outside: int = 0
    n_masked: int = 0
    cause: str = ""
    refusal: str = ""

    @property
    def name(self) -> str:
        """Class folder and file."""
        return name_of(self.path)

    @property
    def left_out(self) -> str:
        """Why it is left out, without its path: a model's record may be given away."""
        return self.refusal.replace(str(self.path), self.name)

    def leave_out(self, cause: str, words: str) -> None:
        """For this cause, and no other that was found before."""
        self.events, self.cause, self.refusal = None, cause, words

    def fit(self, camera: Sensor, who: str) -> None:
        """Leave it out if it is of another sensor than the camera's, (width, height).

        who : says what the camera's are, such as "--sensor says".
        """
        try:
            check_sensor(self.name, self.sensor, camera, who, "")
        except ValueError as error:
            self.leave_out(OTHER_SENSOR, f"{error}.")

    def select(self, selector: PixelSelector, sensor: Sensor, who: str) -> None:
        """Keep of the events those that the network is to see, their times from the first of them on, in order.

        Left out are: a recording with events off the sensor, (width, height), which `who` says, or that the region
        or the mask does not suit; and one of which nothing is left.

        Raises
        ------
        ValueError : it lasts too long.
        """
        if self.events is None or self.is_selected:
            return
        off = _off_sensor(self.events, sensor)
        if off:
            words = f"{self.name}: every event must lie on the {by(sensor)} sensor, got {off} ({who} {by(sensor)})."
            return self.leave_out(OTHER_SENSOR, words)
        try:
            keep = selector.filter_of(self.name, sensor)
        except ValueError as error:
            return self.leave_out(OTHER_SENSOR, _told(error, self.path))
        if isinstance(keep, PixelFilter):
            keep.reset()
        seen = from_first_event(keep(self.events))
        if isinstance(keep, PixelFilter):
            self.n_outside, self.n_masked = keep.counts.dropped_outside, keep.counts.dropped_masked
        if len(seen) == 0:
            return self.leave_out(UNSEEN, f"{self.name}: no events at the pixels that are not left out")
        if seen["t"][-1] >= LONGEST_US:
            raise ValueError(
                f"{self.path}: lasts {seen['t'][-1] / 60e6:.0f} minutes, more than the 35 that training takes; "
                "cut it into shorter recordings"
            )
        self.events, self.is_selected = seen, True


def read_own(path: Path, label: int, selector: PixelSelector) -> OwnRecording:
    """All events of a recording, not selected yet; or, where it cannot be read or is empty, why it is left out."""
    own = OwnRecording(path, label)
    try:
        recording = open_recording(path, strict=True, sensor=selector.selection.camera)
        events = recording.read()
    except (ValueError, OSError) as error:
        own.leave_out(DAMAGED, _told(error, path))
        return own
    if len(events) == 0:
        own.leave_out(EMPTY, f"{own.name}: no events")
        return own
    if recording.stated_sensor is not None:
        own.sensor = int(recording.stated_sensor[0]), int(recording.stated_sensor[1])
    own.events, own.recorded = events, fingerprint(events)
    return own


def from_first_event(events: np.ndarray) -> np.ndarray:
    """Times from the first event on, in order; the times of `events` are changed in place."""
    if len(events) == 0:
        return events
    events["t"] -= events["t"][0]
    if (np.diff(events["t"]) < 0).any():
        events = events[events["t"] >= 0]
        events = events[np.argsort(events["t"], kind="stable")]
    return events


def fingerprint(events: np.ndarray) -> bytes:
    """Equal for equal events, whatever file they come from and whatever time it begins at. At least one event."""
    hashed = hashlib.blake2b(digest_size=16)
    hashed.update((events["t"].astype(np.int64) - np.int64(events["t"][0])).tobytes())
    for name, dtype in (("x", np.uint16), ("y", np.uint16), ("p", np.uint8)):
        hashed.update(np.ascontiguousarray(events[name], dtype).tobytes())
    return hashed.digest()


def _off_sensor(events: np.ndarray, sensor: Sensor) -> str:
    """The first event off the sensor, in words; "" where there is none."""
    for name, side in zip("xy", sensor, strict=True):
        if int(events[name].max()) >= side:
            i = int(np.flatnonzero(events[name] >= side)[0])
            return f"{name} = {events[name][i]} at event {i}"
    return ""


def _told(error: Exception, path: Path) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}."
    text = str(error)
    text = text if path.name in text else f"{name_of(path)}: {text}"
    return text if text.endswith(".") else f"{text}."
