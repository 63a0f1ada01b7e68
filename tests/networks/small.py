"""A small model, with a landmark network and without, and files of any content.

The tests in this folder use them.
"""

import json

from made import random_model, thesis_network

from async_tnt import TNTConfig
from async_tnt.networks.models.model import FORMAT
from async_tnt.networks.models.model_file import checksum, tensor_bytes

SMALL = TNTConfig(sensor=(9, 8), grid=(5, 6), bins=2)
WITH_REGRESSOR = SMALL.replace(landmark="regressor")
CLASSES = ("a", "b", "c")


def small_model(seed=0, config=SMALL):
    return random_model(config, classes=3, widths=(2, 3, 4), regressor_widths=(5, 6, 7), seed=seed)


def changed(config=SMALL, **weights):
    """The small model's weights with some replaced, or left out (None)."""
    weights = small_model(config=config).weights | {
        name.replace("__", "."): w for name, w in weights.items()
    }
    return {name: values for name, values in weights.items() if values is not None}


def assert_same(one, other):
    assert (one.config, one.classes, one.record) == (other.config, other.classes, other.record)
    assert one.weights.keys() == other.weights.keys()
    for name, values in one.weights.items():
        assert values.dtype == other.weights[name].dtype == "float32"
        assert values.shape == other.weights[name].shape
        assert values.tobytes() == other.weights[name].tobytes()


def write_file(path, weights, of=SMALL, /, **changes):
    """A model file with a valid checksum, whatever it holds.

    of : its configuration. changes : its metadata; None leaves a name out.
    """
    values = {
        "format": FORMAT,
        "config": json.dumps(of.to_dict()),
        "classes": json.dumps(CLASSES),
        "record": "{}",
        "network": json.dumps(thesis_network(of)),
        **changes,
    }
    values = {name: value for name, value in values.items() if value is not None}
    text = json.dumps({name: values[name] for name in sorted(values)})
    sha256 = {} if "sha256" in changes else {"sha256": checksum(weights, text)}
    path.write_bytes(tensor_bytes(weights, values | sha256))
    return path
