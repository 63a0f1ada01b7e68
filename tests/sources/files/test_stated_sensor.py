"""What a file states wrongly is blamed on the file, never on an option that the caller gave."""

import re

import numpy as np
import pytest
from sources.files.written import FORMATS, SENSOR, made_events, written

from async_tnt.base.checks import ParameterError
from async_tnt.sources import open_recording

FROM_CAMERA = ("davis.aedat", "caer.aedat", "plain.bin")
"""Formats in which the sensor is that of a camera which is named, or of the format."""
NOT_WRITTEN = ("dv.aedat4", "metavision.hdf5")
"""Formats whose writer refuses such a sensor, or which then state none."""
STATING = [
    name
    for name, format in sorted(FORMATS.items())
    if format.states_sensor and name not in FROM_CAMERA + NOT_WRITTEN
]


@pytest.mark.parametrize("name", STATING)
def test_an_impossible_sensor_is_an_error_of_the_file(tmp_path, name):
    path = written(tmp_path / name, made_events(10), (0, 240))
    with pytest.raises(ValueError, match=rf"{re.escape(name)}: .*\b(sensor|width)\b") as caught:
        open_recording(path, sensor=SENSOR)
    assert not isinstance(caught.value, ParameterError)
    assert "`sensor`" not in str(caught.value)


def test_the_program_names_the_file_and_its_field(tmp_path, program):
    path = tmp_path / "bad.npz"
    np.savez(path, events=made_events(10, sensor=(34, 34)), sensor=(0, 34))
    code, _, message = program("run", path, "--sensor", "34x34")
    assert code == 2
    assert f"{path}: not a readable NumPy file: its array 'sensor' must be two integers" in message
    assert "--sensor" not in message


def test_the_program_names_the_option_where_the_option_would_help(tmp_path, program):
    events = made_events(10)
    table = np.stack([events[name].astype(np.int64) for name in "xypt"], axis=1)
    np.save(tmp_path / "a.npy", table)
    code, _, message = program("run", tmp_path / "a.npy")
    assert code == 2
    assert "a.npy: the columns are not 'txyp'; they look like 'xypt'" in message
    assert "state their order with --columns, or save a structured array" in message
