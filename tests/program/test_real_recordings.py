"""The promise of equality on real recordings: a part of them here, all with `async-tnt check`."""

import numpy as np
import pytest

from async_tnt import load_model
from async_tnt.checking.equality import check_recording
from async_tnt.sources.files.nmnist import read_nmnist


@pytest.mark.parametrize("digit", range(10))
def test_stream_equals_batch_on_a_real_recording(data, digit):
    path = sorted((data / "nmnist" / "Test" / str(digit)).glob("*.bin"))[digit]
    comparisons = check_recording(read_nmnist(path), load_model("digits"), prefixes=4)
    assert [c for c in comparisons if not c.holds] == []


def test_digits_on_some_real_recordings(data):
    """Every tenth test recording; all of them: docs/results.md."""
    from async_tnt import Processor

    processor = Processor(load_model("digits"), start_us=0)
    right = []
    for digit in range(10):
        for path in sorted((data / "nmnist" / "Test" / str(digit)).glob("*.bin"))[::10]:
            processor.reset()
            events = read_nmnist(path)
            decisions = processor.push(events[events["t"] < 315_000]) + processor.finish()
            right += [decision.label == str(digit) for decision in decisions]
    assert len(right) == 300 and np.mean(right) >= 0.95
