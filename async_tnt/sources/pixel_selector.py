"""Apply a selection of pixels to sources: recordings are opened here, and dropped events are counted."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from async_tnt.sources.files.recording import Recording, open_recording
from async_tnt.sources.pixel_filter import PixelCounts, PixelFilter
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.sources.sensor import TRAIN_ONE, Sensor, check_events, check_sensor, format_size

NONE_YET = PixelCounts()


class PixelSelector:
    """Drops the events of sources that a model is not meant to see, and counts them.

    Parameters
    ----------
    selection : what the model sees.
    model : (width, height) in pixels that the model is for.

    Attributes
    ----------
    expected : (width, height) of the cameras, before any event is dropped; None: the source must state it.

    Raises
    ------
    ValueError : a region of another size than the model's sensor; without `crop`, a camera of another size, if the
        selection names one; a region off the camera, if that is known.
    """

    def __init__(self, selection: PixelSelection, model: Sensor) -> None:
        self.selection = selection
        self.expected = selection.camera if selection.crop else model
        self._model = model
        self._filters: dict[Sensor, PixelFilter] = {}
        _check_fit(selection, model)
        if self.expected is not None:
            self.filter_of("", self.expected)  # now, so that mistakes show before the first event

    def sensor_of(self, name: Any, found: Sensor | None) -> Sensor:
        """The sensor of a source's camera, before any event is dropped; `found` as the source states it, if it does.
        `name` is for messages.

        Raises
        ------
        ValueError : not the expected one, or unknown.
        """
        if self.expected is not None:
            check_sensor(name, found, self.expected, self._origin, self._advice(found))
            return self.expected
        if found is None:
            raise ValueError(f"{name}: does not say the camera's pixels, which `crop` needs: give `sensor`")
        return found[0], found[1]

    def open(
        self,
        path: Path,
        *,
        name: str | None = None,
        strict: bool = False,
        between_us: tuple[int, int] | None = None,
    ) -> tuple[Recording, Sensor]:
        """A recording, or its part between two times, and the sensor of its events, for `filter_of`.

        `path`, `strict` and `between_us` are those of `open_recording`. `name` is for messages; by default the path.

        Raises
        ------
        ValueError, OSError : unreadable, or of another sensor than expected.
        """
        recording = open_recording(path, strict=strict, sensor=self.expected, between_us=between_us)
        return recording, self.sensor_of(path if name is None else name, recording.sensor)

    def check_events(self, packets: Iterable[Any], name: Any, sensor: Sensor) -> None:
        """Refuse `packets` of a source that does not state its sensor, if an event is off this `sensor`; `name` is for
        the message."""
        check_events(packets, sensor, name, self._origin, self._advice(None))

    def filter_of(self, name: Any, sensor: Sensor) -> Callable[[Any], Any]:
        """The filter for packets of a source with this `sensor`. `name` is for messages; "" for none.

        Raises
        ------
        ValueError : the region or the mask does not fit that sensor.
        """
        chosen = self.selection
        if not chosen.leaves_out:
            return _unchanged
        if sensor not in self._filters:
            try:
                mask = None if chosen.mask is None else chosen.mask.pixels(sensor)
                self._filters[sensor] = PixelFilter(sensor, chosen.roi, mask, crop=chosen.crop)
            except ValueError as error:
                raise ValueError(f"{name}: {error}" if name else str(error)) from None
        return self._filters[sensor]

    @property
    def counts(self) -> PixelCounts:
        """Events so far, of all sources; all zero if nothing can be dropped."""
        return sum((pixel_filter.counts for pixel_filter in self._filters.values()), NONE_YET)

    def summary(self, since: PixelCounts = NONE_YET) -> str:
        """What was dropped after `since`, earlier `counts`, for people; "" if nothing came or could be dropped."""
        counts = self.counts - since
        parts = []
        if counts.received and self.selection.roi is not None:
            parts.append(f"{counts.dropped_outside:,} outside of the region")
        if counts.received and self.selection.mask is not None:
            parts.append(f"{counts.dropped_masked:,} of masked pixels")
        return ", ".join(parts)

    def nothing_left(self, since: PixelCounts = NONE_YET) -> str:
        """Why a model has seen no event after `since`, earlier `counts`; "" if it has seen one, or nothing came."""
        dropped = self.summary(since)
        return f"no events are left: {dropped}" if dropped and self.counts.kept == since.kept else ""

    @property
    def _origin(self) -> str:
        """Where `expected` comes from, for messages."""
        selection = self.selection
        if not selection.crop:
            return "the model is for"
        return "`sensor` says" if selection.mask is None or selection.sensor else f"{selection.mask.name} is a mask of"

    def _advice(self, found: Sensor | None) -> str:
        """What to do about a camera of another size than the model is for; None: of an unknown one."""
        if self.selection.crop:
            return ""
        if found is None:
            return f"; {TRAIN_ONE}, or cut out a part: {_cut_out(self._model)} `sensor`"
        part = f", or cut out a part: {_cut_out(self._model)}" if _is_part(self._model, found) else ""
        return f"; {TRAIN_ONE}{part}"


def _check_fit(selection: PixelSelection, model: Sensor) -> None:
    """Refuse a cropped region, or without one a camera, of another size than the model is for."""
    region, camera, mask = selection.region, selection.camera, selection.mask
    if region not in (None, model):
        raise ValueError(
            f"`crop`: the model is for {format_size(model)} pixels, got a region of {format_size(region)}; "
            f"give `roi` X,Y,{model[0]},{model[1]}"
        )
    if selection.crop or camera is None or camera == model:
        return
    part = f"give {_cut_out(model)} too, or " if _is_part(model, camera) else ""
    if mask is None:
        raise ValueError(
            f"`sensor` says {format_size(camera)} pixels, but the model is for {format_size(model)}: {part}{TRAIN_ONE}"
        )
    transposed = "; or transpose it with .T" if camera == model[::-1] else ""
    raise ValueError(
        f"{mask.name}: a mask of a {format_size(camera)} camera, but the model is for {format_size(model)} pixels: "
        f"{part}give the mask of a {format_size(model)} camera{transposed}"
    )


def _is_part(model: Sensor, camera: Sensor) -> bool:
    return model[0] <= camera[0] and model[1] <= camera[1]


def _cut_out(model: Sensor) -> str:
    return f"`roi` X,Y,{model[0]},{model[1]} `crop`"


def _unchanged(packet: Any) -> Any:
    return packet
