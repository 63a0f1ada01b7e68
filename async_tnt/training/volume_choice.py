"""The volume that a user asks for, and which of its fields the data set decides."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from async_tnt.training.settings import default_config, default_grid, with_bins
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.sensor import Sensor


@dataclass(frozen=True)
class VolumeChoice:
    """A volume. The data set decides some of its fields.

    Parameters
    ----------
    config : the chosen volume. The data set replaces its sensor and the fields `fitted`.
    fitted : the fields that the data set decides. "grid": the default grid of the sensor, see
        `default_grid`. "window_us": if no recording is as long as a window, windows become as long
        as the longest recording. "bins": time bins if pixels fire often, see `with_bins`.

    Examples
    --------
    >>> choice = VolumeChoice.of(window_us=50_000)
    >>> choice.config.window_us, sorted(choice.fitted)
    (50000, ['bins', 'grid'])
    """

    config: TNTConfig
    fitted: Collection[str] = ()

    @classmethod
    def of(
        cls,
        *,
        grid: Sensor | None = None,
        window_us: int | None = None,
        in_bins: bool = False,
        **fields: Any,
    ) -> VolumeChoice:
        """The choice of a user. The data set decides the rest.

        Parameters
        ----------
        grid, window_us : fields of `TNTConfig`; None: the data set decides. A window that slides is
            on the sensor's own grid.
        in_bins : whether there are time bins, however often pixels fire. Ignored if there are
            `fields`.
        fields : other fields of `TNTConfig`. If there are any, the data set does not decide on time
            bins.

        Raises
        ------
        ValueError, TypeError : as `TNTConfig`.
        """
        fitted = set()
        sizes: dict[str, Any] = {}
        for name, value in (("grid", grid), ("window_us", window_us)):
            if value is None:
                fitted.add(name)
            else:
                sizes[name] = value
        config = default_config(**sizes, **fields)
        if not fields and in_bins:
            config = with_bins(config)
        elif not fields:
            fitted.add("bins")
        return cls(config, frozenset(fitted))

    def known(self, sensor: Sensor | None) -> dict[str, Any]:
        """The fields that are known before the data set is read, as `TNTConfig.to_dict` has them.

        sensor : (width, height) of the events; None: it is not known yet.
        """
        open_fields = {"sensor", *self.fitted}
        if "bins" in self.fitted:
            open_fields.add("representation")
        fields = self.config.to_dict()
        known = {name: value for name, value in fields.items() if name not in open_fields}
        return known if sensor is None else {**known, "sensor": sensor}

    def for_recordings(self, sensor: Sensor, longest_us: int | None) -> TNTConfig:
        """The volume for recordings of a sensor. Its time bins are decided later, by `with_bins`.

        longest_us : the length of the longest recording; None: there is none.
        """
        if self.config.slides:
            return self.config.replace(sensor=sensor, grid=sensor)
        grid = default_grid(sensor) if "grid" in self.fitted else self.config.grid
        config = self.config.replace(sensor=sensor, grid=grid)
        if "window_us" not in self.fitted or longest_us is None or longest_us >= config.window_us:
            return config
        whole_ms = -(-longest_us // 1000)  # rounded up
        return config.replace(window_us=1000 * whole_ms)
