"""Landmark "regressor" in a Processor: decisions equal the torch pipeline's, and `async-tnt check` says so."""

import numpy as np
import pytest
from deciding import total_and_size
from made import random_events, random_regressor_model

from async_tnt import Processor, TNTConfig, stream
from async_tnt.checking.equality import check_recording
from async_tnt.checking.reference import reference_pipeline
from async_tnt.networks.compiled import CompiledRegressor

CONFIG = TNTConfig(window_us=1000, landmark="regressor", t_max=2.0)
MODEL = random_regressor_model(CONFIG, widths=(3, 4, 5), regressor_widths=(9, 5, 8), sharpness=20.0)


@pytest.mark.parametrize(
    "settings, polarity", [({"every_events": 37}, "signed"), ({"hop_us": 300, "every_us": 170}, "split")]
)
def test_decisions_equal_the_torch_pipeline(settings, polarity):
    config = CONFIG.replace(polarity=polarity, sensor=(40, 34), grid=(34, 30), bins=5)
    model = random_regressor_model(config, sharpness=10.0, seed=2)
    pipeline = reference_pipeline(model)
    events = random_events(700, seed=1, duration_us=3500, sensor=(20, 20), start_us=50)
    decisions = list(stream(np.split(events, 14), model, **settings))
    assert len(decisions) >= 4
    for decision in decisions:
        inside = events[events["t"] >= decision.window_start_us][: decision.events]
        assert inside["t"][-1] == decision.time_us
        expected = pipeline(inside, decision.window_start_us)
        assert np.abs(decision.logits - expected).max() <= 1e-4
        assert decision.index == expected.argmax()
    assert len({decision.logits.tobytes() for decision in decisions}) > len(decisions) / 2


def test_a_callable_beside_a_configuration_or_in_place_of_a_models():
    seen = []

    def regressor(raw):
        seen.append(raw.shape)
        return 20.0, 10.0

    processor = Processor(CONFIG, classifier=total_and_size, regressor=regressor, hop_us=500)
    assert processor.landmark == (16.5, 16.5) and not seen
    decisions = processor.push(random_events(300, duration_us=2000))
    assert decisions and set(seen) == {(9, 34, 34)} and processor.landmark == (20.0, 10.0)
    mine, models = Processor(MODEL, regressor=regressor), Processor(MODEL)
    for one in (mine, models):
        one.push(random_events(200, duration_us=900))
    assert mine.landmark == (20.0, 10.0) != models.landmark and mine.fire().label in MODEL.classes


def test_check_sees_a_regressor_that_is_off(monkeypatch):
    right = CompiledRegressor.__call__
    monkeypatch.setattr(CompiledRegressor, "__call__", lambda self, raw: tuple(np.add(right(self, raw), 2e-4)))
    model = random_regressor_model(regressor_widths=(9, 20, 8), sharpness=5.0)
    comparisons = check_recording(random_events(400, duration_us=200_000, sensor=(20, 25)), model, prefixes=5)
    failed = [(c.what, c.config) for c in comparisons if not c.holds]
    assert failed == [("landmark against reference, px", "regressor")]
