"""A selection of pixels, applied to sources: recordings are opened here, and what is left out is counted."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from async_tnt.sources.files.fitting import TRAIN_ONE, check_events, check_sensor, open_for, open_of_known
from async_tnt.sources.files.recording import Recording, open_recording
from async_tnt.sources.files.source import Sensor
from async_tnt.sources.pixel_filter import PixelCounts, PixelFilter
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.sources.sizes import by


class PixelSelector:
    """Leaves out of sources what a model is not to see, and counts it.

    Parameters
    ----------
    selection : what the model is to see.
    model : (width, height) in pixels that the model is for; None where it is to be trained on the sources.

    Raises
    ------
    ValueError : a region of another size than the model's sensor; without `crop`, a camera of another size, as the
        selection names it; or, as far as the camera is known by now, a region that is not on it.
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
        """The pixels of a source's events, before any is left out; None: the source must say."""
        if self.selection.crop or self._model is None:
            return self.selection.camera
        return self._model

    @property
    def said_by(self) -> tuple[str, str]:
        """Words for a refusal, where there is an `expected`: who says it, and what to do with another camera."""
        if not self.selection.crop and self._model is not None:
            return "the model is for", self._advice(None)
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
        check_sensor(name, found, wanted, self.said_by[0], self._advice(found))
        return wanted

    def open(self, path: Path, *, name: str | None = None, strict: bool = False) -> tuple[Recording, Sensor]:
        """A recording, and the pixels of its events, for `filter_of`.

        A `.bin` does not say its sensor. Where the selection names the camera, it is of that; else `open_for` looks
        at its events.

        Parameters
        ----------
        name : of the recording in messages on its sensor; by default its path.
        strict : as for `open_recording`.

        Raises
        ------
        ValueError, OSError : unreadable, or of another sensor than the model is for.
        """
        if self.selection.camera is None:
            recording = open_for(path, self.expected, strict=strict)
        else:
            recording = open_of_known(path, strict=strict)
        return recording, self.sensor_of(path if name is None else name, recording.sensor)

    def open_to_learn(self, path: Path, *, strict: bool = False) -> Recording:
        """A recording that a model is to be trained on; its `sensor`, None where unknown so far, makes the model's.

        Sensors are not compared here, as others may say what this one does not. That of the selection is somebody's
        word on this very camera, not what a model would need: a `.bin` is of it, wherever its events lie.
        """
        return open_recording(path, strict=strict, sensor=self.selection.camera)

    def check_silent(self, packets: Iterable[Any], name: Any, sensor: Sensor) -> None:
        """Refuse packets of a source that does not say its sensor, if an event is off this one.

        Raises
        ------
        ValueError : says who says the sensor, and what to do.
        """
        check_events(packets, sensor, name, *self.said_by)

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

    @property
    def counts(self) -> PixelCounts:
        """Events so far, of all sources; none where nothing can be left out."""
        return sum((pixel_filter.counts for pixel_filter in self._filters.values()), PixelCounts())

    def summary(self, since: PixelCounts | None = None) -> str:
        """What was left out, in words; "" where nothing came, or nothing could be.

        Parameters
        ----------
        since : `counts` as they were at the start of what is told; None: of all sources.
        """
        counts = self.counts if since is None else self.counts - since
        if not counts.received:
            return ""
        told = []
        if self.selection.roi is not None:
            told.append(f"{counts.dropped_outside:,} outside of the region")
        if self.selection.mask is not None:
            told.append(f"{counts.dropped_masked:,} of masked pixels")
        return ", ".join(told)

    def nothing_left(self, since: PixelCounts | None = None) -> str:
        """Why a model has seen nothing of what came, in words; "" where something was left, or nothing came."""
        left_out = self.summary(since)
        kept = (self.counts if since is None else self.counts - since).kept
        return f"no events are left: {left_out}" if left_out and not kept else ""

    def _advice(self, found: Sensor | None) -> str:
        """What to do with a camera of another size, (width, height), than the model is for; None: of an unknown one."""
        if self.selection.crop or self._model is None:
            return ""
        if found is None:
            return f"; {TRAIN_ONE}, or cut out a part: {_cut_out(self._model)} --sensor WxH"
        if _is_part(self._model, found):
            return f"; {TRAIN_ONE}, or cut out a part: {_cut_out(self._model)}"
        return f"; {TRAIN_ONE}"


def check_region(selection: PixelSelection, model: Sensor) -> None:
    """Refuse a region that is to be the sensor of a model for another size (width, height)."""
    region = selection.region
    if region is not None and region != model:
        raise ValueError(
            f"--crop: the model is for {by(model)} pixels, got a region of {by(region)}; "
            f"give --roi X,Y,{model[0]},{model[1]}"
        )


def _check_camera(selection: PixelSelection, model: Sensor) -> None:
    """Refuse a camera that the selection names, of another size than the model is for."""
    camera = selection.camera
    if camera is None or camera == model:
        return
    part = f"give {_cut_out(model)} too, or " if _is_part(model, camera) else ""
    if selection.mask is None:
        raise ValueError(f"--sensor says {by(camera)} pixels, but the model is for {by(model)}: {part}{TRAIN_ONE}")
    turned = "; or turn it with .T" if camera == model[::-1] else ""
    raise ValueError(
        f"{selection.mask.name}: a mask of a {by(camera)} camera, but the model is for {by(model)} pixels: {part}"
        f"give the mask of a {by(model)} camera{turned}"
    )


def _is_part(model: Sensor, camera: Sensor) -> bool:
    return model[0] <= camera[0] and model[1] <= camera[1]


def _cut_out(model: Sensor) -> str:
    return f"--roi X,Y,{model[0]},{model[1]} --crop"


def _as_it_is(packet: Any) -> Any:
    return packet
