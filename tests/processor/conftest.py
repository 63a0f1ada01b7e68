"""Shared by the tests of triggers."""

from functools import partial

import pytest
from deciding import CONFIG, total_and_size
from made import random_model

from async_tnt import Processor


@pytest.fixture(params=["callable", "compiled"])
def make(request):
    """A Processor with the settings given, of either kind: a callable decides, or compiled code for whole packets."""
    if request.param == "callable":
        return partial(Processor, CONFIG, classifier=total_and_size)
    return partial(Processor, random_model(CONFIG))
