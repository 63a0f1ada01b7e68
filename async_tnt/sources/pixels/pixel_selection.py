"""Which pixels a model sees: as plain values that can be compared, sent and stored, and applied to
sources."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from async_tnt.sources.files.recording import Recording, open_recording
from async_tnt.sources.pixels.pixel_filter import PixelFilter, check_crop, checked_region
from async_tnt.sources.pixels.pixel_masks import PackedMask
from async_tnt.volume.sensor import Sensor, check_sensor, checked_sensor, format_size

Region = tuple[int, int, int, int]


@dataclass(frozen=True)
class PixelSelection:
    """The pixels that a model sees: frozen, picklable and without state; `PixelSelector` applies
    it.

    Parameters
    ----------
    roi : region of interest (x, y, width, height); None: the whole sensor.
    crop : the region is the model's sensor: coordinates are shifted to its upper left corner.
    mask : pixels of the whole camera whose events are dropped; None: no pixel.
    sensor : (width, height) of the camera, for sources that do not state it.

    Raises
    ------
    ValueError : `crop` without `roi`; an impossible region or sensor; a mask of another size than
        `sensor`.

    Example
    -------
    >>> PixelSelection(roi=(40, 20, 34, 34), crop=True).about
    {'roi': '40,20,34,34', 'crop': True}
    >>> PixelSelection().about
    {}
    """

    roi: Region | None = None
    crop: bool = False
    mask: PackedMask | None = None
    sensor: Sensor | None = None

    def __post_init__(self) -> None:
        check_crop(self.crop, self.roi)
        if self.roi is not None:
            object.__setattr__(self, "roi", checked_region(self.roi))
        if self.sensor is not None:
            object.__setattr__(self, "sensor", checked_sensor(self.sensor))
        if self.mask is not None and self.sensor is not None and self.sensor != self.mask.size:
            raise ValueError(
                f"{self.mask.name}: a mask of {format_size(self.mask.size)} pixels, but the "
                "camera's are given as "
                f"{format_size(self.sensor)} (`sensor`)"
            )

    @property
    def camera(self) -> Sensor | None:
        """(width, height) of the camera, from `sensor` or the mask's size; None if the source must
        state it."""
        return self.sensor if self.mask is None else self.mask.size

    @property
    def region(self) -> Sensor | None:
        """(width, height) of what the model sees with `crop`; None without."""
        return (self.roi[2], self.roi[3]) if self.crop and self.roi is not None else None

    @property
    def origin(self) -> str:
        """Where `camera` comes from, for messages: "... 346x260 pixels"."""
        return (
            "`sensor` says"
            if self.mask is None or self.sensor
            else f"{self.mask.name} is a mask of"
        )

    @property
    def leaves_out(self) -> bool:
        """Whether any event could be dropped."""
        return self.roi is not None or self.mask is not None

    @property
    def about(self) -> dict[str, Any]:
        """Option -> value, short and for JSON, of all that decides which events are seen; {} for
        all events.

        Results have it so that those of different selections are not mixed, and the record of a
        trained model has it.

        With a mask, `sensor` could only repeat its size. Without one, it decides which recordings
        are of this camera, and so which have results and which errors: results of different sensors
        must not be mixed.
        """
        options: dict[str, Any] = {}
        if self.roi is not None:
            options["roi"] = ",".join(map(str, self.roi))
        if self.crop:
            options["crop"] = True
        if self.mask is not None:
            options["mask"] = f"{format_size(self.mask.size)} {self.mask.sha256[:16]}"
        elif self.sensor is not None:
            options["sensor"] = format_size(self.sensor)
        return options


class PixelSelector:
    """Drops the events of sources that a model is not meant to see, and counts them.

    Parameters
    ----------
    selection : what the model sees.
    model : (width, height) in pixels that the model is for.
    any_size : whether it can be for others, see `Model.for_sensor`; for messages.

    Attributes
    ----------
    expected : (width, height) of the cameras, before any event is dropped; None: the source must
        state it.

    Raises
    ------
    ValueError : a region of another size than the model's sensor; without `crop`, a camera of
        another size, if the selection names one; a region off the camera, if that is known.
    """

    def __init__(self, selection: PixelSelection, model: Sensor, *, any_size: bool = False) -> None:
        self.selection = selection
        self.expected = selection.camera if selection.crop else model
        self._model, self._any_size = model, any_size
        self._filters: dict[Sensor, PixelFilter] = {}
        region, camera = selection.region, selection.camera
        if region not in (None, model):
            raise ValueError(
                f"`crop`: the model is for {format_size(model)} pixels, got a region of "
                f"{format_size(region)}; "
                f"give `roi` X,Y,{model[0]},{model[1]}"
            )
        if not selection.crop and camera is not None and camera != model:
            raise ValueError(
                f"{selection.origin} {format_size(camera)} pixels, but the model is for "
                f"{format_size(model)}"
                f"{self._advice(camera)}"
            )
        if self.expected is not None:
            self.filter_of("", self.expected)  # now, so that mistakes show before the first event

    def open(
        self, path: Path, *, name: str | None = None, **reading: Any
    ) -> tuple[Recording, Callable[[Any], Any]]:
        """A recording and the filter for its packets.

        `path` and `reading` are arguments of `open_recording`. `name` is for messages; by default
        the path.

        Raises
        ------
        ValueError, OSError : unreadable, or of another sensor than expected.
        """
        recording = open_recording(path, sensor=self.expected, **reading)
        return recording, self.filter_of(path if name is None else name, recording.sensor)

    def filter_of(self, name: Any, found: Sensor | None) -> Callable[[Any], Any]:
        """The filter for packets of a source.

        Parameters
        ----------
        name : of the source, for messages; "" for none.
        found : (width, height) of its camera, before any event is dropped, if it states them.

        Raises
        ------
        ValueError : not the expected sensor, or an unknown one; the region or the mask does not fit
            it.
        """
        chosen = self.selection
        sensor = self.expected or found
        if sensor is None:
            raise ValueError(
                f"{name}: does not say the camera's pixels, which `crop` needs: give `sensor`"
            )
        if chosen.crop:
            check_sensor(name, found, sensor, chosen.origin)
        else:
            check_sensor(name, found, sensor, advice=self._advice(found))
        if not chosen.leaves_out:
            return lambda packet: packet
        if sensor not in self._filters:
            try:
                mask = None if chosen.mask is None else chosen.mask.pixels(sensor)
                self._filters[sensor] = PixelFilter(sensor, chosen.roi, mask, crop=chosen.crop)
            except ValueError as error:
                raise ValueError(f"{name}: {error}" if name else str(error)) from None
        return self._filters[sensor]

    def summary(self) -> str:
        """What was dropped of all sources so far, for people; "" if nothing came or could be
        dropped."""
        counts = [pixel_filter.counts for pixel_filter in self._filters.values()]
        parts = []
        if any(one.received for one in counts) and self.selection.roi is not None:
            parts.append(f"{sum(one.dropped_outside for one in counts):,} outside of the region")
        if any(one.received for one in counts) and self.selection.mask is not None:
            parts.append(f"{sum(one.dropped_masked for one in counts):,} of masked pixels")
        return ", ".join(parts)

    @property
    def nothing(self) -> str:
        """What a model has seen of a source without any event left, for messages."""
        return "no events at the selected pixels" if self.selection.leaves_out else "no events"

    def _advice(self, camera: Sensor | None) -> str:
        """What to do about a camera of another size than the model's."""
        (width, height), size = self._model, camera or self._model
        if self._any_size:
            return f"; give `sensor` {format_size(size)}"
        part = (
            f", or cut out a part: `roi` X,Y,{width},{height} `crop`"
            if width <= size[0] and height <= size[1]
            else ""
        )
        return f"; train one for this camera (async-tnt train){part}"
