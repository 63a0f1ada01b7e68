"""A selection of pixels, applied to sources: recordings are opened here, and what is left out is counted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from ..recordings import Recording, open_recording
from ..recordings.fitting import TRAIN_ONE, check_sensor, open_for
from ..recordings.source import Sensor
from .pixel_filter import PixelFilter
from .selection import PixelSelection


class PixelSelector:
    """Leaves out of sources what a model is not to see, and counts it.

    Parameters
    ----------
    selection : what the model is to see.
    model : (width, height) in pixels that the model is for; None where it is to be trained on the sources.

    Raises
    ------
    ValueError : a region of another size than the model's sensor, or, as far as the camera is known by now, a region
        or a mask that is not on it.
    """

    def __init__(self, selection: PixelSelection, model: Sensor | None) -> None:
        self.selection = selection
        self._model = model
        self._filters: dict[Sensor, PixelFilter] = {}
        if model is not None:
            check_region(selection, model)
        if self.expected is not None:
            self.filter_of("", self.expected)  # now, so that mistakes show before the first event

    @property
    def expected(self) -> Sensor | None:
        """The pixels of a source's events, before any is left out; None: the source must say."""
        if self.selection.crop or self._model is None:
            return self.selection.camera
        return self._model

    @property
    def advice(self) -> str:
        """What to do with a camera of another size than the model is for."""
        if self._model is None:
            return TRAIN_ONE
        return f"{TRAIN_ONE}, or cut out a part: --roi X,Y,{self._model[0]},{self._model[1]} --crop"

    @property
    def said_by(self) -> tuple[str, str]:
        """Who says what is `expected`, and what to do with a camera of another size: words for a refusal."""
        if not self.selection.crop and self._model is not None:
            return "the model is for", f"; {self.advice}"
        if self.selection.sensor is None and self.selection.mask is not None:
            return f"{self.selection.mask.name} is a mask of", ""
        return "--sensor says", ""

    def sensor_of(self, name: Any, found: Sensor | None) -> Sensor:
        """The pixels of a source's events, before any is left out.

        Parameters
        ----------
        name : of the source, for messages.
        found : (width, height) as the source says; None where it does not.

        Raises
        ------
        ValueError : not those that the model is for, or unknown where they are needed.
        """
        wanted = self.expected
        if wanted is None:
            if found is None:
                needs = "--crop" if self.selection.crop else "--roi"
                raise ValueError(f"{name}: does not say the camera's pixels, which {needs} needs: give --sensor WxH")
            return found[0], found[1]
        check_sensor(name, found, wanted, *self.said_by)
        return wanted

    def open(self, path: Path, *, name: str | None = None, strict: bool = False) -> tuple[Recording, Sensor]:
        """A recording, and the pixels of its events, for `select` or `filter_of`.

        Parameters
        ----------
        name : of the recording in messages on its sensor; by default its path.
        strict : as for `open_recording`.

        Raises
        ------
        ValueError, OSError : unreadable, or of another sensor than the model is for.
        """
        recording = open_for(path, self.expected, strict=strict)
        return recording, self.sensor_of(path if name is None else name, recording.sensor)

    def open_to_learn(self, path: Path, *, strict: bool = False) -> tuple[Recording, Sensor | None]:
        """A recording that a model is to be trained on, and its pixels, which make the model's; None: unknown so far.

        Sensors are not compared here, as others may say what this one does not. That of the selection is somebody's
        word on this very camera, not what a model would need: a `.bin` is of it, wherever its events lie.
        """
        recording = open_recording(path, strict=strict, sensor=self.selection.camera)
        return recording, recording.sensor or self.selection.camera

    def filter_of(self, name: Any, sensor: Sensor | None) -> Callable[[Any], Any]:
        """What makes of a packet of such a sensor one without the events that are to be left out.

        Parameters
        ----------
        name : of the source, for messages; "" for none.

        Raises
        ------
        ValueError : the region or the mask does not suit that sensor, or it is None where it must be known.
        """
        if not self.selection.leaves_out:
            return _as_it_is
        if sensor is None:
            sensor = self.sensor_of(name, None)
        if sensor not in self._filters:
            chosen = self.selection
            try:
                mask = None if chosen.mask is None else chosen.mask.pixels(sensor)
                self._filters[sensor] = PixelFilter(sensor, chosen.roi, mask, crop=chosen.crop)
            except ValueError as error:
                raise ValueError(f"{name}: {error}" if name else str(error)) from None
        return self._filters[sensor]

    def select(self, packets: Iterable[Any], sensor: Sensor, name: Any = "") -> Iterator[Any]:
        """The packets of a source with such a sensor, without the events that are to be left out."""
        if not self.selection.leaves_out:
            return iter(packets)
        return map(self.filter_of(name, sensor), packets)

    def summary(self) -> str:
        """What was left out so far, in words; "" where nothing came, or nothing could be."""
        counts = [pixel_filter.counts for pixel_filter in self._filters.values()]
        if not any(c.received for c in counts):
            return ""
        told = []
        if self.selection.roi is not None:
            told.append(f"{sum(c.dropped_outside for c in counts):,} outside of the region")
        if self.selection.mask is not None:
            told.append(f"{sum(c.dropped_masked for c in counts):,} of masked pixels")
        return ", ".join(told)


def check_region(selection: PixelSelection, model: Sensor) -> None:
    """Refuse a region that is to be the sensor of a model for another size (width, height)."""
    region = selection.region
    if region is not None and region != model:
        raise ValueError(
            f"--crop: the model is for {model[0]}x{model[1]} pixels, got a region of {region[0]}x{region[1]}; "
            f"give --roi X,Y,{model[0]},{model[1]}"
        )


def _as_it_is(packet: Any) -> Any:
    return packet
