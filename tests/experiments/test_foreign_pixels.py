"""A simulator that is not ours sees the images, motions and scene of our sets."""

from __future__ import annotations

import sys
import textwrap

import numpy as np
import pytest

from experiments.digit_data.small_sets import write_small_mnist
from experiments.moving_set.build import open_set
from experiments.moving_set.foreign_pixels import SETTINGS, WHITE, build_foreign

EMULATOR = """
import cv2
import numpy as np
from screeninfo import get_monitors

class EventEmulator:
    '''An event where the light differs by a tenth from the light of the pixel's last event.'''

    def __init__(self, device, seed, **settings):
        assert device == "cpu" and seed > 0 and settings == SETTINGS
        self.level = None

    def generate_events(self, frame, seconds):
        light = np.log(frame)
        if self.level is None:
            self.level = light
            return None
        y, x = np.nonzero(np.abs(light - self.level) > 0.1)
        sign = np.sign(light - self.level)[y, x]
        self.level[y, x] = light[y, x]
        return np.stack([np.full(len(x), seconds), x, y, sign], 1) if len(x) else None
"""


@pytest.fixture
def v2e(tmp_path, monkeypatch):
    """A folder with the layout of v2e, and a simple emulator."""
    (tmp_path / "v2e" / "v2ecore").mkdir(parents=True)
    text = f"SETTINGS = {SETTINGS}\n{textwrap.dedent(EMULATOR)}"
    (tmp_path / "v2e" / "v2ecore" / "emulator.py").write_text(text)
    yield tmp_path / "v2e"
    for name in [name for name in sys.modules if name.startswith("v2ecore")]:
        del sys.modules[name]


def test_images_side_by_side_come_back_as_recordings_of_their_own(v2e, tmp_path):
    mnist = write_small_mnist(tmp_path, 5)
    modules = set(sys.modules)
    made = build_foreign(v2e, mnist, tmp_path / "set", which=[0, 3, 4])
    # what stands in for v2e's own imports is gone
    assert not [n for n in set(sys.modules) - modules if n.split(".")[0] in ("cv2", "screeninfo")]
    opened = open_set(made.folder)
    assert len(opened.shards) == 30 and len(opened) == 90
    for shard in opened:
        assert shard.image.tolist() == [0, 3, 4]
        for i in range(3):
            events = shard.recording(i)
            assert len(events) > 20 and (np.diff(events["t"]) >= 0).all()
            assert events["x"].max() < 34 and events["y"].max() < 34
            # the digits are dark on a bright ground: OFF events lead in the direction of motion
            ahead = events[["x", "y"]][events["p"] == 0]
            behind = events[["x", "y"]][events["p"] == 1]
            lead = [ahead[axis].mean() - behind[axis].mean() for axis in "xy"]
            assert np.dot(lead, shard.flow[i, 0]) > 0
    # what exists is kept
    before = made.shards[0].stat().st_mtime_ns
    build_foreign(v2e, mnist, tmp_path / "set", which=[0, 3, 4])
    assert made.shards[0].stat().st_mtime_ns == before
    assert WHITE == 255


def test_a_folder_without_the_simulator_is_refused(tmp_path):
    mnist = write_small_mnist(tmp_path, 5)
    with pytest.raises(FileNotFoundError, match="expected a checkout of https://github"):
        build_foreign(tmp_path, mnist, tmp_path / "set", which=[0])
