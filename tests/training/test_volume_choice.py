"""The volume that a training is asked for, and what a data set decides of it."""

import pytest

from async_tnt.training.volume_choice import VolumeChoice
from async_tnt.volume.config import TNTConfig


def test_what_is_not_asked_for_is_decided_by_the_data_set():
    assert VolumeChoice.of().fitted == {"grid", "window_us", "bins"}
    assert VolumeChoice.of(grid=(20, 16), window_us=50_000).fitted == {"bins"}
    assert VolumeChoice.of(in_bins=True).fitted == {"grid", "window_us"}
    assert VolumeChoice.of(in_bins=True).config.representation == "volume"
    counted = VolumeChoice.of(in_bins=True, representation="count_time", polarity="split")
    assert counted.fitted == {"grid", "window_us"}
    assert counted.config.representation == "count_time"
    with pytest.raises(ValueError, match="remove_flow"):
        VolumeChoice.of(remove_flow=True)


def test_what_the_data_set_decides_is_not_known_before_it_is_read():
    known = VolumeChoice.of(window_us=50_000).known((20, 16))
    assert known["window_us"] == 50_000 and known["sensor"] == (20, 16)
    assert not {"grid", "bins", "representation"} & known.keys()
    everything = VolumeChoice(TNTConfig()).known(None)
    assert everything.keys() == TNTConfig().to_dict().keys() - {"sensor"}


@pytest.mark.parametrize(
    ("longest_us", "window_us"),
    [(None, 105_000), (105_000, 105_000), (104_999, 105_000), (20_001, 21_000)],
)
def test_windows_are_no_longer_than_the_longest_recording_in_whole_milliseconds(
    longest_us, window_us
):
    found = VolumeChoice.of().for_recordings((346, 260), longest_us)
    assert (found.sensor, found.grid, found.window_us) == ((346, 260), (120, 90), window_us)
    asked = VolumeChoice.of(window_us=105_000, grid=(20, 16))
    found = asked.for_recordings((346, 260), longest_us)
    assert (found.grid, found.window_us) == ((20, 16), 105_000)
