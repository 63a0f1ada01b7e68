"""TNTConfig checks itself, cannot be changed, and survives JSON."""

import json
import re
from collections import OrderedDict
from dataclasses import FrozenInstanceError, fields
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from async_tnt import TNTConfig
from async_tnt.config import LANDMARKS, POLARITIES, TRANSFORMS

NAMES = "bins, grid, landmark, polarity, remove_flow, sensor, t_max, transform, window_us"
OTHER = {
    "sensor": (346, 260),
    "grid": (64, 48),
    "bins": 4,
    "window_us": 20_000,
    "t_max": 2.5,
    "landmark": "line",
    "polarity": "split",
    "transform": "tnt",
    "remove_flow": True,
}

NO_SIZES = (34, None, "ab", (34,), (34, 34, 34), (34.0, 34), (True, 34), {34, 35}, np.array([34, 34]), (34, [34]))
NO_WHOLE_NUMBERS = (9.0, "9", None, True, np.True_, np.array([9, 9]), Fraction(9))
NO_NUMBERS = ("8", None, True, (8.0,), np.array(8.0), 8j, np.True_)
NO_NAMES = ("", "nonsense", None, 0, [], np.array(["a", "b"]), b"center")
FLOW = '`remove_flow` needs landmark="line" and transform="tnt", got landmark={!r}, transform={!r}'
CELLS = "`grid` and `bins` must give fewer than 2**31 cells, got {}"

WRONG = [
    *[
        ({name: value}, TypeError, f"`{name}` must be two whole numbers (width, height), got {value!r}")
        for name in ("sensor", "grid")
        for value in NO_SIZES
    ],
    *[
        ({name: value}, ValueError, f"`{name}` must have sides of 2 to 32768 pixels, got {value}")
        for name in ("sensor", "grid")
        for value in ((1, 34), (34, 1), (34, -34), (32769, 34), (34, 10**30))
    ],
    *[
        ({name: value}, TypeError, f"`{name}` must be a whole number, got {value!r}")
        for name in ("bins", "window_us")
        for value in NO_WHOLE_NUMBERS
    ],
    *[({"bins": value}, ValueError, f"`bins` must be in [1, 1024], got {value}") for value in (0, 1025, 10**30)],
    *[
        ({"window_us": value}, ValueError, f"`window_us` must be in [1, 3600000000], got {value}")
        for value in (0, 3_600_000_001)
    ],
    *[({"t_max": value}, TypeError, f"`t_max` must be a number, got {value!r}") for value in NO_NUMBERS],
    *[
        ({"t_max": value}, ValueError, f"`t_max` must be in [1e-6, 1e6], got {float(value)}")
        for value in (0, -8.0, 9e-7, 1e6 + 1, float("inf"), float("nan"), Fraction(1, 10**7))
    ],
    ({"t_max": 10**400}, ValueError, "`t_max` must be in [1e-6, 1e6], got inf"),
    *[
        ({name: value}, ValueError, f"`{name}` must be one of {', '.join(allowed)}, got {value!r}")
        for name, allowed in (("landmark", LANDMARKS), ("polarity", POLARITIES), ("transform", TRANSFORMS))
        for value in (*NO_NAMES, allowed[0].upper())
    ],
    *[
        ({"remove_flow": value}, TypeError, f"`remove_flow` must be True or False, got {value!r}")
        for value in (1, None, np.True_)
    ],
    *[
        (
            {"remove_flow": True, "landmark": landmark, "transform": transform},
            ValueError,
            FLOW.format(landmark, transform),
        )
        for landmark, transform in (("center", "tnt"), ("line", "none"), ("window", "none"))
    ],
    ({"grid": (32768, 32767), "bins": 1}, ValueError, CELLS.format(2147549184)),
    ({"grid": (1023, 1023), "bins": 1024}, ValueError, CELLS.format(2147483648)),
    ({"grid": (1023, 1023), "bins": 512, "polarity": "split"}, ValueError, CELLS.format(2147483648)),
]


@pytest.mark.parametrize(("values", "error", "message"), WRONG, ids=lambda value: str(value)[:40])
def test_a_value_that_breaks_its_rule_is_refused(values, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        TNTConfig(**values)
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        TNTConfig(sensor=(40, 30)).replace(**values)


def test_the_limits_themselves_are_allowed():
    assert TNTConfig(sensor=(2, 32768), grid=(2, 32768)).shape == (9, 32768, 2)
    assert TNTConfig(bins=1).shape == (1, 34, 34)
    assert TNTConfig(window_us=1, t_max=1e-6) != TNTConfig(window_us=3600 * 10**6, t_max=1e6)
    assert TNTConfig(grid=(1023, 1022), bins=1024).channels == 1024  # 2,145,386,496 cells


def test_defaults_are_the_thesis():
    config = TNTConfig()
    assert (config.sensor, config.grid, config.bins, config.t_max) == ((34, 34), (34, 34), 9, 8.0)
    assert (config.window_us, config.landmark, config.polarity) == (105_000, "running", "signed")
    assert (config.transform, config.remove_flow) == ("tnt", False)


@pytest.mark.parametrize("number", [int, np.int8, np.uint16, np.int32, np.uint64, np.array])
def test_numbers_of_any_type_become_pythons_own(number):
    made = TNTConfig(
        sensor=(number(50), number(40)), grid=[number(20), number(30)], bins=number(7), window_us=number(99)
    )
    expected = TNTConfig(sensor=(50, 40), grid=(20, 30), bins=7, window_us=99)
    assert made == expected and hash(made) == hash(expected)
    assert {type(value) for value in (*made.sensor, *made.grid, made.bins, made.window_us)} == {int}


@pytest.mark.parametrize("value", [2, np.float32(2), np.int32(2), Fraction(2), np.float16(2)])
def test_t_max_becomes_a_float(value):
    config = TNTConfig(t_max=value)
    assert config == TNTConfig(t_max=2.0) and type(config.t_max) is float


def test_a_configuration_is_a_value_and_cannot_be_changed():
    size = [346, 260]
    config = TNTConfig(**OTHER | {"sensor": size})
    size[0] = 1
    config.to_dict()["grid"][0] = 5
    for name, value in OTHER.items():
        with pytest.raises(FrozenInstanceError):
            setattr(config, name, value)
    assert config == TNTConfig(**OTHER) == config.replace() and hash(config) == hash(TNTConfig(**OTHER))
    for changes in ({"sensor": [9, 8]}, {"bins": np.int64(3)}, {"polarity": "signed"}, {"remove_flow": False}):
        assert config.replace(**changes) == TNTConfig(**OTHER | changes) != config
    with pytest.raises(TypeError, match="nonsense"):
        config.replace(nonsense=1)


@st.composite
def configs(draw):
    landmark, transform = draw(st.sampled_from(LANDMARKS)), draw(st.sampled_from(TRANSFORMS))
    side = st.integers(2, 300)
    return TNTConfig(
        sensor=(draw(side), draw(side)),
        grid=(draw(side), draw(side)),
        bins=draw(st.integers(1, 1024)),
        window_us=draw(st.integers(1, 3_600_000_000)),
        t_max=draw(st.floats(1e-6, 1e6)),
        landmark=landmark,
        polarity=draw(st.sampled_from(POLARITIES)),
        transform=transform,
        remove_flow=(landmark, transform) == ("line", "tnt") and draw(st.booleans()),
    )


@given(configs())
def test_any_configuration_survives_json(config):
    values = config.to_dict()
    assert list(values) == [field.name for field in fields(TNTConfig)]
    restored = TNTConfig.from_dict(json.loads(json.dumps(values)))
    assert restored == config and restored.to_dict() == values
    assert config.shape == (config.bins * (1 + (config.polarity == "split")), *config.grid[::-1])


def test_from_dict_takes_any_mapping_and_fills_in_defaults():
    assert TNTConfig.from_dict(OrderedDict(bins=3)) == TNTConfig(bins=3)


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ({"z": 9, "bins": 9, 1: 1}, ValueError, f"unknown configuration 1, z; known: {NAMES}"),
        (["bins"], TypeError, "a configuration must be a mapping of names to values, got ['bins']"),
        (None, TypeError, "a configuration must be a mapping of names to values, got None"),
        ({"sensor": [34]}, TypeError, "`sensor` must be two whole numbers (width, height), got (34,)"),
    ],
)
def test_from_dict_refuses(values, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        TNTConfig.from_dict(values)


JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda parts: st.one_of(st.lists(parts, max_size=3), st.dictionaries(st.text(max_size=3), parts, max_size=3)),
    max_leaves=5,
)


@given(st.one_of(JSON, st.dictionaries(st.sampled_from(sorted(OTHER)), JSON | st.sampled_from(list(OTHER.values())))))
def test_any_json_is_a_configuration_or_refused(values):
    try:
        config = TNTConfig.from_dict(values)
    except (ValueError, TypeError) as error:
        assert str(error)
    else:
        assert config == TNTConfig.from_dict(config.to_dict())
