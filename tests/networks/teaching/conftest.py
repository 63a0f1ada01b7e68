"""A model with statistics, and one with a taught class."""

from dataclasses import replace

import pytest
from made import random_events, random_model
from networks.teaching.lessons import CLASSES, CONFIG, of_classes, recording

from async_tnt import Model


@pytest.fixture(scope="module")
def model() -> Model:
    base = replace(random_model(CONFIG, classes=3), classes=CLASSES)
    return base.with_statistics(of_classes(), nothing=[random_events(200, sensor=(20, 16))])


@pytest.fixture(scope="module")
def taught(model) -> Model:
    return model.with_class("d", [recording(3, i) for i in range(6)])
