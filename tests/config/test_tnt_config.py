"""TNTConfig checks itself, cannot be changed, and survives JSON."""

import json
import pickle
import re
from collections import OrderedDict
from dataclasses import FrozenInstanceError, fields
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given, settings
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

WRONG = [
    # sizes
    *[
        ({name: value}, TypeError, f"`{name}` must be two whole numbers (width, height), got {value!r}")
        for name in ("sensor", "grid")
        for value in (
            34,
            None,
            "34",
            "ab",
            (34,),
            (34, 34, 34),
            (34.0, 34),
            (34, "34"),
            (True, 34),
            (34, None),
            {34, 35},
            (34, [34]),
            (34, np.float32(34)),
            np.array([34, 34]),
            ((34, 34), (34, 34)),
            (2, np.array([3, 4])),
        )
    ],
    *[
        ({name: value}, ValueError, f"`{name}` must have sides of 2 to 32768 pixels, got {value}")
        for name in ("sensor", "grid")
        for value in ((1, 34), (34, 1), (0, 34), (34, -34), (32769, 34), (34, 10**30))
    ],
    # whole numbers
    *[
        ({name: value}, TypeError, f"`{name}` must be a whole number, got {value!r}")
        for name in ("bins", "window_us")
        for value in (9.0, "9", None, True, np.True_, np.float64(9), (9,), np.array([9, 9]), int, Fraction(9), 9j)
    ],
    *[({"bins": value}, ValueError, f"`bins` must be in [1, 1024], got {value}") for value in (0, -9, 1025, 10**30)],
    *[
        ({"window_us": value}, ValueError, f"`window_us` must be in [1, 3600000000], got {value}")
        for value in (0, -1, 3_600_000_001, 10**30)
    ],
    # numbers
    *[
        ({"t_max": value}, TypeError, f"`t_max` must be a number, got {value!r}")
        for value in ("8", "a", None, True, (8.0,), [8.0], np.array([8.0]), np.array(8.0), 8j, np.True_, float)
    ],
    *[
        ({"t_max": value}, ValueError, f"`t_max` must be in [1e-6, 1e6], got {got}")
        for value, got in (
            (0, "0.0"),
            (-8.0, "-8.0"),
            (9e-7, "9e-07"),
            (1e6 + 1, "1000001.0"),
            (float("inf"), "inf"),
            (-float("inf"), "-inf"),
            (float("nan"), "nan"),
            (10**400, "inf"),
            (Fraction(1, 10**7), "1e-07"),
        )
    ],
    # names
    *[
        ({name: value}, ValueError, f"`{name}` must be one of {', '.join(allowed)}, got {value!r}")
        for name, allowed in (("landmark", LANDMARKS), ("polarity", POLARITIES), ("transform", TRANSFORMS))
        for value in ("", "nonsense", allowed[0].upper(), None, 0, [], {}, np.array(["a", "b"]), b"center")
    ],
    *[
        ({"remove_flow": value}, TypeError, f"`remove_flow` must be True or False, got {value!r}")
        for value in (1, 0, None, "True", np.True_)
    ],
    # together
    *[
        (
            {"remove_flow": True, "landmark": landmark, "transform": transform},
            ValueError,
            '`remove_flow` needs landmark="line" and transform="tnt", '
            f"got landmark={landmark!r}, transform={transform!r}",
        )
        for landmark in LANDMARKS
        for transform in TRANSFORMS
        if (landmark, transform) != ("line", "tnt")
    ],
    (
        {"grid": (32768, 32767), "bins": 1},
        ValueError,
        "`grid` and `bins` must give fewer than 2**31 cells, got 2147549184",
    ),
    (
        {"grid": (1023, 1023), "bins": 1024},
        ValueError,
        "`grid` and `bins` must give fewer than 2**31 cells, got 2147483648",
    ),
    (
        {"grid": (1023, 1023), "bins": 512, "polarity": "split"},
        ValueError,
        "`grid` and `bins` must give fewer than 2**31 cells, got 2147483648",
    ),
]


@pytest.mark.parametrize(("values", "error", "message"), WRONG)
def test_rule(values, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        TNTConfig(**values)
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        TNTConfig(sensor=(40, 30)).replace(**values)


def test_the_limits_themselves_are_allowed():
    assert TNTConfig(sensor=(2, 32768), grid=(2, 32768)).shape == (9, 32768, 2)
    assert TNTConfig(bins=1).shape == (1, 34, 34)
    assert TNTConfig(bins=1024).bins == 1024
    assert TNTConfig(window_us=1).window_us == 1
    assert TNTConfig(window_us=3600 * 10**6).window_us == 3600 * 10**6
    assert TNTConfig(t_max=1e-6).t_max == 1e-6
    assert TNTConfig(t_max=1e6).t_max == 1e6
    assert TNTConfig(grid=(1023, 1022), bins=1024).channels == 1024  # 2,145,386,496 cells


@pytest.mark.parametrize("landmark", LANDMARKS)
@pytest.mark.parametrize("polarity", POLARITIES)
@pytest.mark.parametrize("transform", TRANSFORMS)
def test_every_name_is_allowed_with_every_other(landmark, polarity, transform):
    config = TNTConfig(landmark=landmark, polarity=polarity, transform=transform, bins=5, grid=(20, 30))
    assert config.channels == (10 if polarity == "split" else 5)
    assert config.shape == (config.channels, 30, 20)


def test_defaults_are_the_thesis():
    config = TNTConfig()
    assert (config.sensor, config.grid, config.bins, config.t_max) == ((34, 34), (34, 34), 9, 8.0)
    assert (config.window_us, config.landmark, config.polarity) == (105_000, "running", "signed")
    assert (config.transform, config.remove_flow) == ("tnt", False)


# -- what is taken as a number -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "number", [int, np.int8, np.uint8, np.int16, np.uint16, np.int32, np.int64, np.uint64, np.array]
)
def test_whole_numbers_of_every_kind(number):
    made = TNTConfig(
        sensor=(number(50), number(40)), grid=[number(20), number(30)], bins=number(7), window_us=number(99)
    )
    assert made == TNTConfig(sensor=(50, 40), grid=(20, 30), bins=7, window_us=99)
    assert hash(made) == hash(TNTConfig(sensor=(50, 40), grid=(20, 30), bins=7, window_us=99))
    for name in ("sensor", "grid"):
        assert type(getattr(made, name)) is tuple
        assert [type(side) for side in getattr(made, name)] == [int, int]
    assert type(made.bins) is type(made.window_us) is int
    assert json.loads(json.dumps(made.to_dict())) == made.to_dict()


def test_sizes_as_lists_and_tensors():
    assert TNTConfig(sensor=[346, 260]).sensor == (346, 260)
    assert TNTConfig(sensor=torch.Size([346, 260])).sensor == (346, 260)
    assert TNTConfig(bins=torch.tensor(5)).bins == 5


@pytest.mark.parametrize("value", [2, np.float32(2), np.float64(2), np.int32(2), Fraction(2), np.float16(2)])
def test_real_numbers_of_every_kind(value):
    config = TNTConfig(t_max=value)
    assert config == TNTConfig(t_max=2.0)
    assert type(config.t_max) is float
    assert hash(config) == hash(TNTConfig(t_max=2.0))


# -- a value -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", OTHER)
def test_frozen(name):
    config = TNTConfig()
    with pytest.raises(FrozenInstanceError):
        setattr(config, name, OTHER[name])
    with pytest.raises(FrozenInstanceError):
        delattr(config, name)
    assert config == TNTConfig()


def test_a_list_given_as_size_can_change_without_harm():
    size = [346, 260]
    config = TNTConfig(sensor=size)
    size[0] = 1
    assert config.sensor == (346, 260)


def test_equality_and_hash():
    assert TNTConfig(**OTHER) == TNTConfig(**OTHER)
    assert hash(TNTConfig(**OTHER)) == hash(TNTConfig(**OTHER))
    for name, value in OTHER.items():
        if name == "remove_flow":
            one, other = TNTConfig(landmark="line"), TNTConfig(landmark="line", remove_flow=True)
        else:
            one, other = TNTConfig(), TNTConfig(**{name: "none" if name == "transform" else value})
        assert one != other
        assert len({one, other, TNTConfig(), one.replace()}) in (2, 3)
    assert TNTConfig() != "TNTConfig"


def test_replace():
    config = TNTConfig(**OTHER)
    for name, value in (("sensor", [9, 8]), ("bins", np.int64(3)), ("polarity", "signed"), ("remove_flow", False)):
        changed = config.replace(**{name: value})
        assert changed == TNTConfig(**{**OTHER, name: value})
        assert changed != config
    assert config == TNTConfig(**OTHER)
    assert config.replace() == config
    with pytest.raises(TypeError, match="nonsense"):
        config.replace(nonsense=1)


def test_copies_by_pickle():
    assert pickle.loads(pickle.dumps(TNTConfig(**OTHER))) == TNTConfig(**OTHER)


# -- JSON ----------------------------------------------------------------------------------------------------


@st.composite
def configs(draw):
    landmark, transform = draw(st.sampled_from(LANDMARKS)), draw(st.sampled_from(TRANSFORMS))
    side = st.integers(2, 2000)
    return TNTConfig(
        sensor=(draw(side), draw(side)),
        grid=(draw(st.integers(2, 300)), draw(st.integers(2, 300))),
        bins=draw(st.integers(1, 1024)),
        window_us=draw(st.integers(1, 3_600_000_000)),
        t_max=draw(st.floats(1e-6, 1e6)),
        landmark=landmark,
        polarity=draw(st.sampled_from(POLARITIES)),
        transform=transform,
        remove_flow=(landmark, transform) == ("line", "tnt") and draw(st.booleans()),
    )


@settings(max_examples=150, deadline=None)
@given(configs())
def test_any_configuration_survives_json(config):
    values = config.to_dict()
    assert list(values) == [field.name for field in fields(TNTConfig)]
    came_back = TNTConfig.from_dict(json.loads(json.dumps(values)))
    assert came_back == config
    assert hash(came_back) == hash(config)
    assert came_back.to_dict() == values
    assert TNTConfig.from_dict(values) == config


def test_to_dict_is_a_copy():
    config = TNTConfig()
    config.to_dict()["sensor"][0] = 5
    assert config.sensor == (34, 34)


def test_from_dict_takes_any_mapping_and_fills_in_defaults():
    assert TNTConfig.from_dict({}) == TNTConfig()
    assert TNTConfig.from_dict(OrderedDict(bins=3)) == TNTConfig(bins=3)


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ({"bin": 9}, ValueError, f"unknown configuration bin; known: {NAMES}"),
        ({"z": 9, "bins": 9, "a": 1}, ValueError, f"unknown configuration a, z; known: {NAMES}"),
        ({1: 2}, ValueError, f"unknown configuration 1; known: {NAMES}"),
        ([], TypeError, "a configuration must be a mapping of names to values, got []"),
        (["bins"], TypeError, "a configuration must be a mapping of names to values, got ['bins']"),
        ("", TypeError, "a configuration must be a mapping of names to values, got ''"),
        (None, TypeError, "a configuration must be a mapping of names to values, got None"),
        ({"bins": None}, TypeError, "`bins` must be a whole number, got None"),
        ({"sensor": [34]}, TypeError, "`sensor` must be two whole numbers (width, height), got (34,)"),
        ({"bins": 0}, ValueError, "`bins` must be in [1, 1024], got 0"),
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


@settings(max_examples=200, deadline=None)
@given(
    st.one_of(
        JSON, st.dictionaries(st.sampled_from(sorted(OTHER)), st.one_of(JSON, st.sampled_from(list(OTHER.values()))))
    )
)
def test_any_json_is_a_configuration_or_refused(values):
    try:
        config = TNTConfig.from_dict(values)
    except (ValueError, TypeError) as error:
        assert str(error)
    else:
        assert config == TNTConfig.from_dict(config.to_dict())
