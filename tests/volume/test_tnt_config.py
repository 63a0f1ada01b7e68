"""TNTConfig checks itself, cannot be changed, and survives JSON."""

import json
import math
import re
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest

from async_tnt import TNTConfig
from async_tnt.base.checks import ParameterError
from async_tnt.volume.config import LANDMARKS, POLARITIES, REPRESENTATIONS

CELLS = (
    "`grid` and `bins` must give at most 268_435_456 cells, got {:_} "
    "(a program may raise async_tnt.volume.config.MAX_CELLS)"
)
MOST = {
    "bins": 1024,
    "window_events": 1 << 30,
    "window_us": 3_600_000_000,
    "last_events": 1 << 20,
    "last_us": 3_600_000_000,
}
WRONG = [
    *[
        ({"sensor": v}, TypeError, f"`sensor` must be two whole numbers (width, height), got {v!r}")
        for v in (34, (34,), (True, 34))
    ],
    *[
        ({name: side}, ValueError, f"`{name}` must have sides of 1 to 32768 pixels, got {side}")
        for name, side in (("sensor", (0, 34)), ("sensor", (34, 32769)), ("grid", (34, 10**30)))
    ],
    *[
        (
            settings | {name: (34, 1)},
            ValueError,
            f'`{name}` must have sides of at least 2 pixels, unless transform="none" and grid and '
            "sensor are the same, got (34, 1)",
        )
        for name, settings in (
            ("sensor", {}),
            ("sensor", {"grid": (34, 1)}),
            ("sensor", {"transform": "none"}),
            ("grid", {"representation": "count"}),
        )
    ],
    *[
        ({name: v}, TypeError, f"`{name}` must be a whole number, got {v!r}")
        for name, v in (
            ("bins", 9.0),
            ("bins", True),
            ("window_us", False),
            ("bins", np.array([9, 9])),
            ("window_events", 9.0),
        )
    ],
    *[
        ({name: v}, ValueError, f"`{name}` must be in [1, {most}], got {v}")
        for name, most in MOST.items()
        for v in (0, most + 1)
    ],
    (
        {"representation": "count_time", "bins": 9},
        ValueError,
        "`bins` of an image must be 1 (count), 2 (count_time), 1 (mean_time), 1 (time_surface), "
        "got representation='count_time', bins=9",
    ),
    *[
        (
            {"representation": "mean_time", "transform": transform, "polarity": polarity},
            ValueError,
            'an image of times needs transform="none" and polarity "split" or "unsigned", got '
            f"representation='mean_time', transform='{transform}', polarity='{polarity}'",
        )
        for transform, polarity in (("none", "signed"), ("tnt", "split"))
    ],
    *[({"t_max": v}, TypeError, f"`t_max` must be a number, got {v!r}") for v in ("8", True)],
    *[
        ({"t_max": value}, ValueError, f"`t_max` must be in [1e-6, 1e6], got {got}")
        for value, got in (
            (0, 0.0),
            (1e-7, 1e-7),
            (1e6 + 1, 1e6 + 1),
            (math.nan, math.nan),
            (10**400, math.inf),
            (-(10**400), -math.inf),
        )
    ],
    (
        {"landmark": "CENTER"},
        ValueError,
        f"`landmark` must be one of {', '.join(LANDMARKS)}, got 'CENTER'",
    ),
    ({"polarity": 0}, ValueError, f"`polarity` must be one of {', '.join(POLARITIES)}, got 0"),
    *[
        (
            {"representation": v},
            ValueError,
            f"`representation` must be one of {', '.join(REPRESENTATIONS)}, got {v!r}",
        )
        for v in ("histogram", None)
    ],
    ({"transform": "TNT"}, ValueError, "`transform` must be one of tnt, none, got 'TNT'"),
    ({"remove_flow": 1}, TypeError, "`remove_flow` must be True or False, got 1"),
    *[
        (
            {"remove_flow": True, "landmark": landmark, "transform": transform},
            ValueError,
            f'`remove_flow` needs landmark="line" and transform="tnt", got {landmark=}, '
            f"{transform=}",
        )
        for landmark, transform in (("center", "tnt"), ("line", "none"))
    ],
    ({"grid": (1023, 1023), "bins": 128, "polarity": "split"}, ValueError, CELLS.format(257 << 20)),
]


@pytest.mark.parametrize(("values", "error", "message"), WRONG, ids=lambda value: str(value)[:40])
def test_a_value_that_breaks_its_rule_is_refused(values, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        TNTConfig(**values)
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        TNTConfig(sensor=(40, 30)).replace(**values)


def test_the_limits_themselves_are_allowed_and_a_program_may_raise_that_of_cells(monkeypatch):
    assert TNTConfig(sensor=(2, 32768), grid=(2, 32768)).shape == (9, 32768, 2)
    assert TNTConfig(bins=1).shape == (1, 34, 34)
    assert TNTConfig(window_us=1, t_max=1e-6) != TNTConfig(window_us=3600 * 10**6, t_max=1e6)
    assert TNTConfig(grid=(1023, 1023), bins=255).channels == 255  # 2**28 cells
    assert TNTConfig(representation="count", last_events=1 << 20).last_events == 1 << 20
    assert TNTConfig(representation="count", last_us=3_600_000_000).last_us == 3_600_000_000
    monkeypatch.setattr("async_tnt.volume.config.MAX_CELLS", 1 << 30)
    assert TNTConfig(grid=(1023, 1023), bins=1023).channels == 1023


def test_defaults_that_depend_on_the_representation_and_the_windows():
    image = TNTConfig(representation="count_time")
    assert (image.bins, image.polarity, image.transform) == (2, "split", "none")
    assert image.shape == (4, 34, 34)
    for landmark in ("window", "regressor"):
        assert TNTConfig(landmark=landmark).needs_replay
        assert not TNTConfig(landmark=landmark, transform="none").needs_replay
    five_bins = TNTConfig(bins=5, polarity="unsigned")
    assert five_bins.replace(representation="mean_time").shape == (2, 34, 34)
    assert image.replace(representation="volume") == TNTConfig()
    by_events = TNTConfig(window_us=20_000).replace(window_events=9)
    assert by_events == TNTConfig(window_events=9)
    assert by_events.replace(window_events=None) == TNTConfig()
    fifty = by_events.replace(window_us=50).replace(window_events=7)
    assert fifty == TNTConfig().replace(window_events=7, window_us=50) and fifty.window_us == 50


def test_an_error_names_its_parameter_unless_the_value_comes_from_a_file():
    with pytest.raises(ParameterError) as caught:
        TNTConfig(bins=0)
    assert caught.value.name == "bins"
    assert caught.value.text({"bins": "--bins"}) == "--bins must be in [1, 1024], got 0"
    for values, error in (({"bins": 0}, ValueError), ({"bins": "9"}, TypeError)):
        with pytest.raises(error) as caught:
            TNTConfig.from_dict(values)
        assert type(caught.value) is error


@pytest.mark.parametrize("number", [np.int8, np.uint64, np.array])
def test_a_configuration_is_a_value_of_pythons_own_numbers(number):
    made = TNTConfig(
        sensor=(number(50), number(40)),
        grid=[number(20), number(30)],
        bins=number(7),
        t_max=np.float32(2),
    )
    same = TNTConfig(sensor=(50, 40), grid=(20, 30), bins=7, t_max=2.0)
    assert made == same == made.replace() != made.replace(bins=5) and hash(made) == hash(same)
    assert {type(value) for value in (*made.sensor, *made.grid, made.bins)} == {int}
    assert type(made.t_max) is float
    assert TNTConfig(landmark="line", remove_flow=np.True_).remove_flow is True
    with pytest.raises(FrozenInstanceError):
        made.bins = 5
    with pytest.raises(TypeError, match="nonsense"):
        made.replace(nonsense=1)


@pytest.mark.parametrize(
    "config",
    [
        TNTConfig(),
        TNTConfig(
            sensor=(200, 2),
            grid=(3, 4),
            bins=5,
            window_us=1,
            t_max=0.1,
            landmark="line",
            remove_flow=True,
        ),
        TNTConfig(
            window_events=1 << 30, polarity="unsigned", transform="none", landmark="regressor"
        ),
        TNTConfig(window_events=7, window_us=3_600_000_000, representation="count_time"),
    ],
    ids=str,
)
def test_a_configuration_survives_json(config):
    values = config.to_dict()
    names = [field.name for field in fields(TNTConfig)]
    # files of windows that end can be read by releases that know no others
    assert list(values) == [name for name in names if name not in ("last_events", "last_us")]
    restored = TNTConfig.from_dict(json.loads(json.dumps(values)))
    assert restored == config and restored.to_dict() == values


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        (
            {"z": 9, "bins": 9, 1: 1},
            ValueError,
            "unknown configuration 1, z; known: bins, grid, landmark, last_events, last_us, ",
        ),
        (["bins"], TypeError, "a configuration must be a mapping of names to values, got ['bins']"),
        (
            {"sensor": [34]},
            TypeError,
            "`sensor` must be two whole numbers (width, height), got (34,)",
        ),
    ],
)
def test_from_dict_refuses(values, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}"):
        TNTConfig.from_dict(values)
