"""The pixels that a model sees of recordings and cameras, whose sensors may differ from its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from async_tnt.base.checks import ParameterError
from async_tnt.sources.files.recording import Recording, open_recording
from async_tnt.sources.files.source_error import SourceError
from async_tnt.sources.pixels.pixel_filter import PixelFilter
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.volume.sensor import Sensor, format_size


class ModelPixels:
    """Leaves out the events of sources that a model is not meant to see, and counts them.

    Parameters
    ----------
    pixels : the pixels that the model sees.
    model : (width, height) of the model's sensor, in pixels.
    any_size : whether the model can be used for sensors of other sizes, see `Model.for_sensor`. It
        decides only the advice in messages.

    Attributes
    ----------
    pixels : the parameter.
    expected : (width, height) of the cameras, before any event is left out; None: the source must
        state it.

    Raises
    ------
    ValueError : the region has another size than the model's sensor; without `crop`, the camera in
        `pixels` has another size than the model's sensor; or the region lies off the camera, if the
        camera's size is known.
    """

    def __init__(self, pixels: Pixels, model: Sensor, *, any_size: bool = False) -> None:
        self.pixels = pixels
        self.expected = pixels.camera if pixels.crop else model
        self._model = model
        self._any_size = any_size
        self._filters: dict[Sensor, PixelFilter] = {}
        region = pixels.region
        if region is not None and region != model:
            raise SourceError(
                "",
                f"{{crop}}: the model is for {format_size(model)} pixels, got a region of "
                f"{format_size(region)}; give {{roi}} X,Y,{model[0]},{model[1]}",
            )
        camera = pixels.camera
        if not pixels.crop and camera is not None and camera != model:
            raise SourceError(
                "",
                f"{pixels.origin} {format_size(camera)} pixels, but the model is for "
                f"{format_size(model)}{self._advice(camera)}",
            )
        if self.expected is not None:
            # The filter is made now, so that mistakes show before the first event.
            self.filter_of("", self.expected)

    def open(
        self, path: Path, *, name: str | None = None, **reading: Any
    ) -> tuple[Recording, Callable[[Any], Any]]:
        """A recording and the filter for its packets.

        Parameters
        ----------
        path, reading : arguments of `open_recording`.
        name : name of the recording in messages; by default its path.

        Raises
        ------
        ValueError, OSError : the recording is unreadable, or its sensor is not the expected one.
        """
        recording = open_recording(path, sensor=self.expected, **reading)
        return recording, self.filter_of(path if name is None else name, recording.sensor)

    def filter_of(self, name: Any, sensor: Sensor | None) -> Callable[[Any], Any]:
        """The filter for packets of a source.

        Parameters
        ----------
        name : name of the source in messages; "" for none.
        sensor : (width, height) of its camera, before any event is left out, if it states them.

        Raises
        ------
        ValueError : the sensor is not the expected one, or is unknown, or the region or the mask
            does not fit it.
        """
        camera = self.expected or sensor
        if camera is None:
            rule = "does not say the camera's pixels, which {crop} needs: give {sensor}"
            raise SourceError(str(name), rule)
        if sensor is not None and tuple(sensor) != camera:
            origin = self.pixels.origin if self.pixels.crop else "the model is for"
            advice = "" if self.pixels.crop else self._advice(sensor)
            raise SourceError(
                str(name),
                f"a sensor of {format_size(sensor)} pixels, but {origin} {format_size(camera)}"
                f"{advice}",
            )

        if camera not in self._filters:
            pixel_filter = self._new_filter(str(name), camera)
            if pixel_filter is None:
                return _unchanged
            self._filters[camera] = pixel_filter
        return self._filters[camera]

    def _new_filter(self, name: str, camera: Sensor) -> PixelFilter | None:
        """The filter for a camera; None if every event counts. Errors name the source."""
        try:
            return self.pixels.filter_of(camera)
        except ParameterError as error:
            raise SourceError(name, f"{{{error.name}}} {error.rule}, got {error.got}") from None
        except ValueError as error:
            raise ValueError(f"{name}: {error}" if name else str(error)) from None

    def summary(self) -> str:
        """What was left out of all sources so far, as a sentence for people.

        It is "" if no event came, or if no event could be left out.
        """
        counts = [pixel_filter.counts for pixel_filter in self._filters.values()]
        if not any(one.received for one in counts):
            return ""
        parts = []
        if self.pixels.roi is not None:
            n_outside = sum(one.dropped_outside for one in counts)
            parts.append(f"{n_outside:,} outside of the region")
        if self.pixels.mask is not None:
            n_masked = sum(one.dropped_masked for one in counts)
            parts.append(f"{n_masked:,} of masked pixels")
        return ", ".join(parts)

    @property
    def no_events_message(self) -> str:
        """The message about a source that has no event for the model."""
        return "no events at the selected pixels" if self.pixels.leaves_out else "no events"

    def _advice(self, camera: Sensor | None) -> str:
        """What to do about a camera of another size than the model's."""
        size = camera or self._model
        if self._any_size:
            return f"; give {{sensor}} {format_size(size)}"
        width, height = self._model
        if width > size[0] or height > size[1]:
            return "; train one for this camera (async-tnt train)"
        return (
            "; train one for this camera (async-tnt train), or cut out a part: "
            f"{{roi}} X,Y,{width},{height} {{crop}}"
        )


def _unchanged(packet: Any) -> Any:
    """The filter where every event counts: the packet itself."""
    return packet
