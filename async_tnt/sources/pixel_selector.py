"""Apply a selection of pixels to sources: recordings are opened here, and dropped events are counted."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from async_tnt.sources.files.fitting import TRAIN_ONE, check_events, check_sensor, open_for, open_of_known
from async_tnt.sources.files.recording import Recording
from async_tnt.sources.files.source import Sensor
from async_tnt.sources.pixel_filter import PixelCounts, PixelFilter
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.sources.sizes import format_size


class PixelSelector:
    """Drops the events of sources that a model is not to see, and counts them.

    Parameters
    ----------
    selection : what the model is to see.
    model : (width, height) in pixels that the model is for; None if it is to be trained on the sources.

    Raises
    ------
    ValueError : a region of another size than the model's sensor; without `crop`, a camera of another size, if the
        selection names one; a region off the camera, if that is known.
    """

    def __init__(self, selection: PixelSelection, model: Sensor | None) -> None:
        self.selection = selection
        self._model = model
        self._filters: dict[Sensor, PixelFilter] = {}
        if model is not None:
            check_region(selection, model)
            if not selection.crop:
                _check_camera(selection, model)
        if self.expected is not None:
            self.filter_of("", self.expected)  # now, so that mistakes show before the first event

    @property
    def expected(self) -> Sensor | None:
        """(width, height) of the cameras, before any event is dropped; None: the source must say."""
        if self.selection.crop or self._model is None:
            return self.selection.camera
        return self._model

    @property
    def said_by(self) -> tuple[str, str]:
        """Where `expected` comes from, and what to do with another camera, for messages."""
        if not self.selection.crop and self._model is not None:
            return "the model is for", self._advice(None)
        if self.selection.sensor is None and self.selection.mask is not None:
            return f"{self.selection.mask.name} is a mask of", ""
        return "--sensor says", ""

    def sensor_of(self, name: Any, found: Sensor | None) -> Sensor:
        """(width, height) of a source's camera, before any event is dropped.

        Parameters
        ----------
        name : of the source, for messages.
        found : (width, height) as the source says; None where it does not.

        Raises
        ------
        ValueError : another one than expected, or unknown.
        """
        wanted = self.expected
        if wanted is not None:
            check_sensor(name, found, wanted, self.said_by[0], self._advice(found))
            return wanted
        if found is None:
            option = "--crop" if self.selection.crop else "--roi"
            raise ValueError(f"{name}: does not say the camera's pixels, which {option} needs: give --sensor WxH")
        return found[0], found[1]

    def open(self, path: Path, *, name: str | None = None, strict: bool = False) -> tuple[Recording, Sensor]:
        """A recording, and the sensor of its events, for `filter_of`.

        A `.bin` does not say its sensor: the selection does, or `open_for` looks at its events.

        Parameters
        ----------
        name : of the recording in messages on its sensor; by default its path.
        strict : as for `open_recording`.

        Raises
        ------
        ValueError, OSError : unreadable, or of another sensor than expected.
        """
        if self.selection.camera is None:
            recording = open_for(path, self.expected, strict=strict)
        else:
            recording = open_of_known(path, strict=strict)
        return recording, self.sensor_of(path if name is None else name, recording.sensor)

    def check_silent(self, packets: Iterable[Any], name: Any, sensor: Sensor) -> None:
        """Refuse packets of a source that does not say its sensor, if an event is off this one.

        Raises
        ------
        ValueError : with the origin of the sensor, and what to do.
        """
        check_events(packets, sensor, name, *self.said_by)

    def filter_of(self, name: Any, sensor: Sensor | None) -> Callable[[Any], Any]:
        """The filter for packets of a source with this sensor.

        Parameters
        ----------
        name : of the source, for messages; "" for none.

        Raises
        ------
        ValueError : the region or the mask does not fit that sensor, or it is None where it must be known.
        """
        chosen = self.selection
        if not chosen.leaves_out:
            return _unchanged
        if sensor is None:
            sensor = self.sensor_of(name, None)
        if sensor not in self._filters:
            try:
                mask = None if chosen.mask is None else chosen.mask.pixels(sensor)
                self._filters[sensor] = PixelFilter(sensor, chosen.roi, mask, crop=chosen.crop)
            except ValueError as error:
                raise ValueError(f"{name}: {error}" if name else str(error)) from None
        return self._filters[sensor]

    @property
    def counts(self) -> PixelCounts:
        """Events so far, of all sources; all zero where nothing can be dropped."""
        return sum((pixel_filter.counts for pixel_filter in self._filters.values()), PixelCounts())

    def summary(self, since: PixelCounts | None = None) -> str:
        """What was dropped, in words; "" where nothing came, or nothing can be dropped.

        Parameters
        ----------
        since : earlier `counts`; None: from the start.
        """
        counts = self.counts if since is None else self.counts - since
        parts = []
        if counts.received and self.selection.roi is not None:
            parts.append(f"{counts.dropped_outside:,} outside of the region")
        if counts.received and self.selection.mask is not None:
            parts.append(f"{counts.dropped_masked:,} of masked pixels")
        return ", ".join(parts)

    def nothing_left(self, since: PixelCounts | None = None) -> str:
        """Why a model has seen no event, in words; "" where it has seen one, or nothing came."""
        dropped = self.summary(since)
        kept = (self.counts if since is None else self.counts - since).kept
        return f"no events are left: {dropped}" if dropped and not kept else ""

    def _advice(self, found: Sensor | None) -> str:
        """What to do with a camera of another size, (width, height), than the model is for; None: of an unknown one."""
        if self.selection.crop or self._model is None:
            return ""
        if found is None:
            return f"; {TRAIN_ONE}, or cut out a part: {_cut_out(self._model)} --sensor WxH"
        part = f", or cut out a part: {_cut_out(self._model)}" if _is_part(self._model, found) else ""
        return f"; {TRAIN_ONE}{part}"


def check_region(selection: PixelSelection, model: Sensor) -> None:
    """Refuse a cropped region of another size, (width, height), than the model is for."""
    region = selection.region
    if region is not None and region != model:
        raise ValueError(
            f"--crop: the model is for {format_size(model)} pixels, got a region of {format_size(region)}; "
            f"give --roi X,Y,{model[0]},{model[1]}"
        )


def _check_camera(selection: PixelSelection, model: Sensor) -> None:
    """Refuse a selection's camera of another size than the model is for."""
    camera = selection.camera
    if camera is None or camera == model:
        return
    part = f"give {_cut_out(model)} too, or " if _is_part(model, camera) else ""
    if selection.mask is None:
        raise ValueError(
            f"--sensor says {format_size(camera)} pixels, but the model is for {format_size(model)}: {part}{TRAIN_ONE}"
        )
    transposed = "; or transpose it with .T" if camera == model[::-1] else ""
    raise ValueError(
        f"{selection.mask.name}: a mask of a {format_size(camera)} camera, but the model is for {format_size(model)} "
        f"pixels: {part}"
        f"give the mask of a {format_size(model)} camera{transposed}"
    )


def _is_part(model: Sensor, camera: Sensor) -> bool:
    return model[0] <= camera[0] and model[1] <= camera[1]


def _cut_out(model: Sensor) -> str:
    return f"--roi X,Y,{model[0]},{model[1]} --crop"


def _unchanged(packet: Any) -> Any:
    return packet
