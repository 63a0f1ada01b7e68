"""RerunView of a spiking model: the spikes of each layer, beside its answers."""

import numpy as np
import pytest

rrd_files = pytest.importorskip(
    "views.rrd_files", reason="rerun-sdk is not installed (extra `view`)"
)
Rrd = rrd_files.Rrd

from made import random_events  # noqa: E402
from networks.random_spiking import CONFIG, random_spiking_model  # noqa: E402

from async_tnt import Processor  # noqa: E402
from async_tnt.views.rerun_decisions import PROBABILITIES  # noqa: E402
from async_tnt.views.rerun_spikes import SPIKES  # noqa: E402
from async_tnt.views.rerun_view import RerunView  # noqa: E402


@pytest.mark.parametrize("raw", [False, True])
def test_every_picture_has_the_spikes_of_each_layer(tmp_path, raw):
    model = random_spiking_model(9, raw=raw)
    events = random_events(300, duration_us=2_500, sensor=CONFIG.sensor, start_us=50)
    with RerunView(model, out=tmp_path / "a.rrd", picture_us=300) as view:
        for packet in np.array_split(events, 11):
            view.push(packet)
    rrd = Rrd(tmp_path / "a.rrd")
    shown = rrd.series(SPIKES, "Scalars:scalars")
    assert len(shown) > 5
    assert rrd.static(SPIKES, "SeriesLines:names") == list(Processor(model).layer_spikes)
    for at_us, numbers in shown:
        processor = Processor(model)
        processor.push(events[events["t"] < at_us])
        assert list(numbers) == list(processor.layer_spikes.values()), at_us
    assert max(sum(numbers) for _, numbers in shown) > 20
    answers = "outputs/spikes" if raw else PROBABILITIES
    assert len(rrd.series(answers, "Scalars:scalars")) > 3
