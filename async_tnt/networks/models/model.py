"""Model: a configuration, a network and what its outputs are, in one .safetensors file."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.base.checks import (
    ParameterTypeError,
    ParameterValueError,
    plain_array,
)
from async_tnt.base.files import replacing, user_path
from async_tnt.base.messages import short
from async_tnt.networks.layers.graph import (
    CLASSIFIER,
    REGRESSOR,
    SPIKING,
    Network,
    ReadNetwork,
    layer_shapes,
    tensors_of,
)
from async_tnt.networks.layers.layer import Layer, Shape
from async_tnt.networks.layers.operations import OPERATIONS
from async_tnt.networks.layers.reach import Work, work_of_one_event
from async_tnt.networks.models.features import FEATURES, layers_up_to
from async_tnt.networks.models.model_file import checksum_of, tensor_bytes
from async_tnt.networks.models.objects import OF_BOXES, Places, n_of_boxes, places_of
from async_tnt.networks.models.scaled_volume import with_scaled_volume
from async_tnt.networks.spiking.operations import (
    NEURONS,
    SPIKING_OPERATIONS,
    check_spiking_values,
)
from async_tnt.networks.spiking.outputs import check_spiking_outputs
from async_tnt.networks.teaching.statistics import (
    Statistics,
    check_statistics,
    description_of_statistics,
    tensors_of_statistics,
)
from async_tnt.networks.teaching.taught_network import taught_network, trained_network
from async_tnt.networks.teaching.teach import TrainedNetwork, statistics_of, teach
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.sensor import Sensor

if TYPE_CHECKING:
    from torch import nn

    from async_tnt.networks.nir.from_nir import PolarityOrder, Reset

FORMAT = "async_tnt 2"
"""The `format` in a file's metadata.

Its number grows with each change after which older releases cannot read new files."""

FORMAT_OF_OUTPUTS = "async_tnt 3"
"""The `format` in the file of a model of raw outputs, which older releases cannot read."""

FORMAT_OF_SPIKES = "async_tnt 4"
"""The `format` in the file of a spiking model, which older releases cannot read."""

FORMAT_OF_STATISTICS = "async_tnt 5"
"""The `format` in the file of a model with statistics, which older releases cannot read."""

FORMATS = (FORMAT, FORMAT_OF_OUTPUTS, FORMAT_OF_SPIKES, FORMAT_OF_STATISTICS)
"""The formats that this release reads."""

CENTROID = "heatmap_centroid"
"""The operation of a landmark network's last layer."""


GRID_STEP = 8
"""For a model that is `by_share`, `for_sensor` chooses grids whose sides are multiples of this
number. So maps of half the size can be spread to the whole again."""


def in_grid_steps(cells: float) -> int:
    """The multiple of `GRID_STEP` that is nearest to a number of cells; at least one step."""
    return GRID_STEP * max(1, round(cells / GRID_STEP))


@dataclass(frozen=True, eq=False)  # arrays have no single answer to ==
class Model:
    """A network and how events become the volume that it reads.

    A model has either `classes`, which it decides about, or `outputs`: a model of raw outputs
    computes tensors of any meaning, such as the flow at each pixel.

    Parameters
    ----------
    config : TNTConfig.
    weights : float32 arrays, by the names that the network's layers give them.
    classes : names, in the order of the network's logits. A map model finds objects of these
        classes: its network computes a map (n_classes + 1, R, C) of more than one place, whose last
        channel means "no object here".
    record : how the model was trained: data, seed, accuracy, what was tried.
    network : the layers, see `networks.layers.graph`. "classifier" computes logits, or raw outputs,
        from a volume (C, H, W). "regressor" computes the landmark from the raw volume. It is
        present if and only if the configuration has the landmark "regressor" and the transform
        "tnt". In the place of "classifier", "spiking" is a network of neurons that each event goes
        through.
    outputs : name of an output -> the layer of "classifier" that computes it. Only for a model
        without classes.
    by_share : only for a map model: whether it knows objects by the share of the sensor that they
        fill, and not by their pixels, see `for_sensor`.
    statistics : moments of the network's features in each class, see `with_class`; None: the model
        has none. They do not change what the model decides.

    Raises
    ------
    ValueError, TypeError : weights are missing, are not finite, or do not fit the network; or the
        network does not fit the configuration or `classes`, or is larger than
        `networks.layers.graph.MAX_NUMBERS` or `MAX_PRODUCTS`. The message names the layer.
    NotImplementedError : this release cannot run a layer. The message names the layer.
    """

    config: TNTConfig
    weights: Mapping[str, np.ndarray]
    classes: tuple[str, ...] = ()
    record: Mapping[str, Any] = field(default_factory=dict)
    network: Network = field(kw_only=True)
    outputs: Mapping[str, str] = field(default_factory=dict, kw_only=True)
    by_share: bool = field(default=False, kw_only=True)
    statistics: Statistics | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        is_ordered = isinstance(self.classes, Iterable) and not isinstance(
            self.classes, (str, set, frozenset)
        )
        if not is_ordered:
            rule = "must be a tuple or list of names"
            raise ParameterTypeError("classes", rule, short(self.classes))
        if not isinstance(self.record, Mapping):
            raise ParameterTypeError("record", "must be a mapping", short(self.record))
        object.__setattr__(self, "classes", tuple(str(name) for name in self.classes))
        weights = {name: _float32(name, w) for name, w in self.weights.items()}
        object.__setattr__(self, "weights", weights)
        _check_outputs(self.outputs, self.classes)
        object.__setattr__(self, "outputs", dict(self.outputs))
        if len(set(self.classes)) < len(self.classes):
            rule = "must have different names"
            raise ParameterValueError("classes", rule, short(self.classes))
        shapes = _checked_shapes(self.network, weights, self.config, self.outputs)
        if not self.outputs:
            _check_logits(list(shapes.values())[-1], len(self.classes), self.config)
        if type(self.by_share) is not bool:
            raise ParameterTypeError("by_share", "must be a bool", short(self.by_share))
        if self.by_share and self.places is None:
            raise ParameterValueError("by_share", "is for a model that finds objects")
        if self.statistics is not None:
            check_statistics(self.statistics, shapes, self.classes)

    @property
    def is_spiking(self) -> bool:
        """Whether the network is one of neurons, which each event goes through."""
        return SPIKING in self.network

    @property
    def layers(self) -> Sequence[Layer]:
        """The layers of the network that answers: "classifier" or "spiking"."""
        return self.network[SPIKING if self.is_spiking else CLASSIFIER]

    @classmethod
    def from_torch(
        cls,
        module: nn.Module,
        config: TNTConfig,
        classes: Sequence[str] | None = None,
        *,
        record: Mapping[str, Any] | None = None,
        regressor: nn.Module | None = None,
    ) -> Model:
        """A model of a torch module: `nn.Sequential`, or any module that `torch.fx` can trace.

        Parameters
        ----------
        module : volumes (N, C, H, W) -> logits (N, n_classes), or without `classes` one or several
            tensors (N, ...), see `layers_from_torch`. It is read as in eval mode, with the weights
            that it has now.
        config, record : see Model.
        classes : see Model; None for a model of raw outputs. The names of these are "output", or
            for several the keys, fields and numbers of what the module returns, see
            `networks.torch.outputs`.
        regressor : the landmark network, raw volumes -> landmarks. It must be given if and only if
            the configuration needs one.

        Raises
        ------
        NotImplementedError : operations have no compiled form, and the message names them; or the
            module computes something that a trace does not show.
        ValueError, TypeError : see Model.

        Examples
        --------
        >>> from torch import nn
        >>> from async_tnt import CompiledClassifier, Model, TNTConfig
        >>> config = TNTConfig(sensor=(34, 34), bins=5)
        >>> net = nn.Sequential(
        ...     nn.Conv2d(5, 8, 3),
        ...     nn.ReLU(),
        ...     nn.MaxPool2d(2),
        ...     nn.Flatten(),
        ...     nn.Linear(8 * 16 * 16, 2),
        ... )
        >>> model = Model.from_torch(net, config, classes=["left", "right"])
        >>> CompiledClassifier(model).n_classes
        2
        """
        from async_tnt.networks.torch.from_torch import (
            WAY_OUT,
            WAY_OUT_OF_LOGITS,
            check_torch_layers,
            layers_from_torch,
        )

        parts = {CLASSIFIER: module}
        if regressor is not None:
            parts[REGRESSOR] = regressor
        networks: dict[str, ReadNetwork] = {}
        weights: dict[str, np.ndarray] = {}
        try:
            for name, part in parts.items():
                prefix = "" if name == CLASSIFIER else f"{name}."
                # the classifier may have weights whose names begin with this prefix
                while prefix and any(tensor.startswith(prefix) for tensor in weights):
                    prefix = f"_{prefix}"
                networks[name] = layers_from_torch(part, config.shape, prefix)
                weights |= networks[name].weights
            outputs = networks[CLASSIFIER].outputs
            if classes is not None:
                refuse_several_outputs(outputs)
                outputs = {}
            model = cls(
                config,
                weights,
                () if classes is None else classes,  # type: ignore[arg-type]  # `cls` checks it
                record or {},
                network={name: read.layers for name, read in networks.items()},
                outputs=outputs,
            )
            for name, part in parts.items():
                is_raw = name == CLASSIFIER and classes is None
                check_torch_layers(part, networks[name], config.shape, is_raw=is_raw)
        except NotImplementedError as error:
            way_out = WAY_OUT if classes is None else WAY_OUT_OF_LOGITS
            raise NotImplementedError(f"{error}{way_out}") from None
        return model

    @classmethod
    def from_nir(
        cls,
        graph: Any,
        *,
        classes: Sequence[str] | None = None,
        window_us: int | None = None,
        reset: Reset | None = None,
        dt: float | None = None,
        polarity: PolarityOrder | None = None,
        record: Mapping[str, Any] | None = None,
    ) -> Model:
        """A spiking model of a NIR graph. Each event goes through it at its own time.

        A network of ReLUs that `to_nir` wrote as a graph comes back as that network, with its own
        configuration and classes. If `reset` is given, it is read as a spiking network instead.

        Parameters
        ----------
        graph : the path of a .nir file, or a `nir.NIRGraph`. Its input is (2, H, W), the polarity,
            row and column of an event, or (1, H, W) for both polarities alike. (1 or 2, W) and
            (W,) are of a line of pixels: `y` is 0. Its last node is of neurons.
        classes : class names, in the order of the last layer's neurons. The class with most output
            spikes in the window is decided for; of a leaky integrator, that with the largest
            membrane. Without them the model has raw outputs, see
            `networks.spiking.outputs.OUTPUTS`.
        window_us : length of a window in microseconds, by default 105,000. Neurons begin each
            window at rest.
        reset : what a spike does to the membrane, which NIR leaves open: "subtract" takes the
            threshold from it, as often as the membrane is above it; "value" sets it to `v_reset`.
        dt : the time step, in seconds, of the program that trained a network with leaky neurons. An
            input counts r dt / tau.
        polarity : the order of the input's two channels, by default "off_first".
        record : see Model.

        Raises
        ------
        ImportError : h5py is not installed.
        TypeError : the graph leaves `reset` or `dt` open, and it was not passed; or a parameter is
            passed for a network of ReLUs, which has its own.
        NotImplementedError : nodes have no meaning at an event, and the message names them.
        OSError : there is no such file, or it cannot be opened.
        ValueError : the file is damaged, or the graph does not fit together.

        References
        ----------
        - Pedersen et al. 2024, doi:10.1038/s41467-024-52259-9
        """
        from async_tnt.networks.models.nir_import import model_of_nir
        from async_tnt.networks.nir.from_nir import Meaning

        meaning = Meaning(reset, dt, polarity)
        return model_of_nir(cls, graph, meaning, classes, window_us, record)

    @property
    def logits_shape(self) -> Shape:
        """The shape of the classifier's output.

        It is (n_classes,) or (n_classes, 1, 1), and (n_classes + 1, R, C) for a map model.

        Raises
        ------
        ValueError : the model has raw outputs, so it has no logits.
        """
        if self.outputs:
            raise ValueError("a model of raw outputs has no logits: see `output_shapes`")
        return self._shapes[self.layers[-1]["name"]]

    @property
    def output_shapes(self) -> dict[str, Shape]:
        """Name of a raw output -> its shape, (C, H, W) or (N,); empty for a model with classes."""
        shapes = self._shapes
        return {name: shapes[layer] for name, layer in self.outputs.items()}

    def features(self, layer: str | None = None) -> Model:
        """The network up to a layer: a model of one raw output, "features", which is the layer's.

        For clustering, tracking, or heads of one's own. A Processor of it gives the same numbers as
        the whole network has inside, after every event.

        Parameters
        ----------
        layer : name of a layer; by default the one that the first dense layer reads or, without
            dense layers, the one that the last layer reads. Instead of a flattened map, the output
            is the map itself.

        Raises
        ------
        ParameterValueError : there is no such layer.
        NotImplementedError : the network is one of neurons, see `SpikingVolume`.

        Examples
        --------
        >>> from async_tnt import load_model
        >>> load_model("digits").features().output_shapes
        {'features': (32, 8, 8)}
        """
        if self.is_spiking:
            raise NotImplementedError(
                "a network of neurons has no features; SpikingVolume shows the spikes and "
                "membranes of each layer"
            )
        network = {**self.network, CLASSIFIER: layers_up_to(self.layers, layer)}
        tensors = tensors_of([one for layers in network.values() for one in layers])
        return replace(
            self,
            weights={name: w for name, w in self.weights.items() if name in tensors},
            classes=(),
            network=network,
            outputs={FEATURES: network[CLASSIFIER][-1]["name"]},
            by_share=False,
            statistics=None,
        )

    # -- teaching ----------------------------------------------------------------------------------

    def with_statistics(
        self, recordings: Mapping[str, Sequence[Any]], nothing: Sequence[Any] = ()
    ) -> Model:
        """The model with statistics of its classes, so that classes can be taught.

        `async-tnt train` stores them. This is for models without them.

        Parameters
        ----------
        recordings : each of the model's classes -> recordings of it: events in any accepted form,
            or what `open_recording` returns. A few tens of each are enough. If there are many, only
            some are read, which are spread evenly over all.
        nothing : recordings that show none of the classes.

        Raises
        ------
        ValueError, TypeError : a class is missing or has no events; events are invalid; classes
            were taught or forgotten already.
        NotImplementedError : the model finds objects, has raw outputs, or is a spiking one.
        """
        self._check_teachable()
        statistics = self.statistics
        if statistics is not None and statistics.classes != statistics.trained:
            raise ValueError(
                "statistics are of the classes a network was trained on: forget those that were "
                "taught first"
            )
        trained = TrainedNetwork(self.config, self.network, self.weights)
        return replace(self, statistics=statistics_of(trained, self.classes, recordings, nothing))

    def with_class(self, name: str, recordings: Iterable[Any]) -> Model:
        """The model with one more class, taught from a few recordings in closed form.

        The network stays as it is, and gets one logit more, from the numbers of an inner layer. So
        the logits of all other trained classes keep their bits. No recording of them is needed.
        `record["taught"][name]` says what the class was taught from and, by the statistics, which
        share of each other class's windows it takes.

        Parameters
        ----------
        name : name of the class.
        recordings : recordings of the class: events in any accepted form, or what `open_recording`
            returns. Ten are good; with fewer than five, how sure the class is cannot be measured.

        Raises
        ------
        ValueError, TypeError : the model has no statistics or has the class already; the recordings
            have no events, or invalid ones.
        NotImplementedError : the model finds objects, has raw outputs, or is a spiking one.

        References
        ----------
        The equations are in `networks.teaching.closed_form`.

        Examples
        --------
        >>> from async_tnt import load_model
        >>> from async_tnt.sources import open_recording, sample_recordings
        >>> model = load_model("digits")
        >>> nine = model.without_class("8")
        >>> taught = nine.with_class("eight", [open_recording(sample_recordings()[8])])
        >>> taught.classes[-1], len(taught.classes)
        ('eight', 10)
        """
        self._check_teachable()
        statistics = self._needed_statistics()
        if not isinstance(name, str) or not name or not name.isprintable():
            raise ParameterValueError("name", "must be a text that can be printed", short(name))
        if name in self.classes:
            rule = "must be a new class: forget the class of this name first"
            raise ParameterValueError("name", rule, short(name))
        lesson = teach(self._trained_network(), statistics, name, recordings)
        taught = {**self.record.get("taught", {}), name: lesson.record}
        return self._with_classes(lesson.statistics, {**self.record, "taught": taught})

    def without_class(self, name: str) -> Model:
        """The model without a class: a taught one, or one that the network was trained on.

        Forgetting the class that was taught last gives the model from before, bit for bit. Classes
        that were taught after `name` keep the scale of their logits, which was chosen while `name`
        was known. The logit of a class that the network was trained on is still computed, but left
        out.

        Raises
        ------
        ValueError : the model has no statistics, or has no other class, or none of this name.
        NotImplementedError : the model finds objects, has raw outputs, or is a spiking one.
        """
        self._check_teachable()
        statistics = self._needed_statistics()
        if name not in self.classes:
            rule = f"must be one of the classes {', '.join(self.classes)}"
            raise ParameterValueError("name", rule, short(name))
        if len(self.classes) == 1:
            raise ParameterValueError("name", "must not be the model's only class", short(name))
        record = dict(self.record)
        taught = {key: entry for key, entry in record.pop("taught", {}).items() if key != name}
        if taught:
            record["taught"] = taught
        if name not in statistics.margins:
            record["forgotten"] = [*record.get("forgotten", []), name]
        return self._with_classes(statistics.without_class(name), record)

    def _check_teachable(self) -> None:
        """Refuse a model that no class can be taught to."""
        if self.is_spiking:
            kind = "is of neurons"
        elif self.outputs:
            kind = "has raw outputs, and no classes"
        elif self.places is not None:
            kind = "finds objects, and a taught class has no place: train it again"
        else:
            return
        raise NotImplementedError(f"classes are taught to models of windows; this one {kind}")

    def _needed_statistics(self) -> Statistics:
        if self.statistics is None:
            raise ValueError(
                "the model has no statistics of its classes: train it again, or give recordings of "
                "its classes to `with_statistics`"
            )
        return self.statistics

    def _trained_network(self) -> TrainedNetwork:
        """The network without the layers that teaching has added."""
        assert self.statistics is not None
        network, weights = trained_network(self.network, self.weights, self.statistics.logits)
        return TrainedNetwork(self.config, network, weights)

    def _with_classes(self, statistics: Statistics, record: Mapping[str, Any]) -> Model:
        """The model with the classes of these statistics."""
        trained = self._trained_network()
        network, weights = taught_network(
            trained.network, trained.weights, trained.shapes, statistics
        )
        return replace(
            self,
            weights=weights,
            classes=statistics.classes,
            record=record,
            network=network,
            statistics=statistics,
        )

    @property
    def has_sizes(self) -> bool:
        """Whether a map model says how large objects are, by two or four channels of its map."""
        if self.places is None:
            return False
        return n_of_boxes(self.logits_shape[0], len(self.classes)) > 0

    @property
    def places(self) -> Places | None:
        """Where on the sensor the places of a map model's map lie; None for other models."""
        if self.outputs or self.logits_shape[0] == len(self.classes):
            return None
        return places_of(self.layers, self.config)

    def for_sensor(self, sensor: tuple[int, int]) -> Model:
        """A model with the same network for another sensor, at the same scale.

        One pixel of the sensor still becomes as many pixels of the grid as before. If the model is
        `by_share`, the shorter side of the sensor does instead, so that objects that fill the same
        share of it are as large on the grid. Then both sides of the grid are multiples of
        `GRID_STEP`. A cell counts the mean over its pixels: where there are n times as many pixels
        in a cell as before, the network reads the volume divided by n.

        This is meant for map models, and for other networks that have only convolutions and
        poolings. A pooling that had `ceil_mode` in torch keeps the padding that was computed for
        the first sensor. A pooling that had None as one side in torch keeps the side that was
        computed for it.

        Parameters
        ----------
        sensor : (width, height).

        Raises
        ------
        ValueError : the network does not fit volumes of another size, as it has dense layers.
        """
        if len(sensor) != 2:
            raise ParameterValueError("sensor", "must be (width, height)", short(sensor))
        if self.by_share:
            return self._at_same_share((sensor[0], sensor[1]))
        grid = []
        for own_grid, own_side, side in zip(
            self.config.grid, self.config.sensor, sensor, strict=True
        ):
            scale = own_grid / own_side
            grid.append(max(2, round(scale * side)))
        config = self.config.replace(sensor=tuple(sensor), grid=tuple(grid))
        # statistics are of the maps of one size
        statistics = self.statistics if config == self.config else None
        return replace(self, config=config, statistics=statistics)

    def _at_same_share(self, sensor: Sensor) -> Model:
        """The model for another sensor, see `for_sensor`, if this model is `by_share`."""
        if sensor == self.config.sensor:
            return self  # its grid may have other sides, which its user chose
        cells = min(self.config.grid) / min(sensor)
        grid = (in_grid_steps(cells * sensor[0]), in_grid_steps(cells * sensor[1]))
        config = self.config.replace(sensor=sensor, grid=grid)
        pixels = [_pixels_a_cell(one) for one in (self.config, config)]
        layers, tensors = with_scaled_volume(
            CLASSIFIER,
            self.network[CLASSIFIER],
            self.weights,
            config.channels,
            pixels[0] / pixels[1],
        )
        return replace(
            self,
            config=config,
            weights={**self.weights, **tensors},
            network={**self.network, CLASSIFIER: layers},
        )

    @property
    def multiplications(self) -> int:
        """The multiplications of the classifier's convolutions and dense layers, for one volume."""
        shapes = self._shapes
        n = 0
        for layer in self.layers:
            if layer["op"] in ("conv", "dense"):
                weight = self.weights[layer["weights"]["weight"]]
                n += math.prod(shapes[layer["name"]]) * math.prod(weight.shape[1:])
        return n

    @property
    def n_neurons(self) -> int:
        """The number of neurons of a spiking network; 0 for other networks."""
        if not self.is_spiking:
            return 0
        kinds = {operation.name for operation in NEURONS}
        shapes = self._shapes
        return sum(math.prod(shapes[one["name"]]) for one in self.layers if one["op"] in kinds)

    @property
    def work_of_one_event(self) -> Work:
        """The multiplications that one event reaches, at most, and those of a whole pass."""
        config = self.config
        is_on_pixels = config.grid == config.sensor and config.transform == "none"
        return work_of_one_event(
            self.layers,
            config.shape,
            self.weights,
            list(self.outputs.values()) or None,
            n_pixels=1 if is_on_pixels else 2,
        )

    @property
    def _shapes(self) -> dict[str, Shape]:
        """Layer of the classifier -> the shape of its output."""
        tensors = {name: w.shape for name, w in self.weights.items()}
        outputs = list(self.outputs.values()) or None
        operations = SPIKING_OPERATIONS if self.is_spiking else OPERATIONS
        return layer_shapes(self.layers, self.config.shape, tensors, outputs, operations)

    def __repr__(self) -> str:
        sensor = "x".join(map(str, self.config.sensor))
        volume = "x".join(map(str, self.config.shape))
        all_layers = [layer for layers in self.network.values() for layer in layers]
        n_layers = Counter(layer["op"] for layer in all_layers if layer.get("weights"))
        n_weights = sum(w.size for w in self.weights.values())
        if self.outputs:
            shapes = self.output_shapes.items()
            answer = ", ".join(f"{name} {'x'.join(map(str, shape))}" for name, shape in shapes)
        else:
            answer = f"{len(self.classes)} classes"
        parts = [
            answer,
            f"{sensor} -> {volume}",
            *(f"{n} {op}" for op, n in n_layers.items()),
            f"{n_weights:,} weights",
        ]
        return f"Model({', '.join(parts)})"

    def description(self) -> dict[str, str]:
        """The metadata of a file: format, and configuration, classes and record as JSON.

        Those of a model of raw outputs have `outputs`, too, and `by_share` those of such a model.

        Raises
        ------
        TypeError : the record holds something that JSON cannot represent.
        """
        values: dict[str, Any] = {"config": self.config.to_dict(), "classes": self.classes}
        values["record"] = self.record
        if self.outputs:
            values["outputs"] = self.outputs
        if self.by_share:
            values["by_share"] = True
        file_format = FORMAT_OF_OUTPUTS if self.outputs else FORMAT
        if self.is_spiking:
            file_format = FORMAT_OF_SPIKES
        return {"format": file_format} | {name: json.dumps(value) for name, value in values.items()}

    def save(self, path: str | Path) -> Path:
        """Write the model to a .safetensors file; returns its path.

        An existing file is replaced in one step when the new one is complete. If writing fails, the
        existing file stays.

        Raises
        ------
        OSError : the file cannot be written, or there is something else than a regular file.
        TypeError : the record holds something that JSON cannot represent.
        """
        path = user_path(path)
        metadata = self.description() | {"network": json.dumps(self.network)}
        tensors = dict(self.weights)
        if self.statistics is not None:
            tensors |= tensors_of_statistics(self.statistics)
            metadata["format"] = FORMAT_OF_STATISTICS
            metadata["statistics"] = json.dumps(description_of_statistics(self.statistics))
        metadata["sha256"] = checksum_of(tensors, metadata)
        content = tensor_bytes(tensors, metadata)
        with replacing(path) as part:
            part.write_bytes(content)
        return path


def layers_of(model: Model, network: str) -> Sequence[Layer]:
    """The layers of a model's classifier or regressor, which read volumes.

    Raises
    ------
    ValueError : the model is a spiking one.
    """
    if model.is_spiking:
        rule = (
            "must have a network that reads volumes; events go through a spiking model one by one, "
            "in a Processor or a SpikingVolume"
        )
        raise ParameterValueError("model", rule)
    return model.network[network]


def _pixels_a_cell(config: TNTConfig) -> float:
    """The number of pixels in a cell of the grid, away from the border."""
    sides = zip(config.sensor, config.grid, strict=True)
    # a line of pixels has one cell across, and no other size of the grid
    return math.prod(1.0 if side == cells else (side - 1) / (cells - 1) for side, cells in sides)


# -- what a model has to be ------------------------------------------------------------------------


def _float32(name: str, values: Any) -> np.ndarray:
    array = plain_array(name, values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"`{name}` must be an array of numbers, got {array.dtype}")
    # a number that is too large becomes inf, which `_check_values` refuses
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, np.float32).copy()  # the caller may change its array


def refuse_several_outputs(outputs: Mapping[str, str]) -> None:
    """Refuse more than one output of a network that has classes."""
    if len(outputs) > 1:
        rule = "are for a network with one output; leave them out for a model of raw outputs"
        raise ParameterValueError("classes", rule, f"{len(outputs)} outputs, {short([*outputs])}")


def _check_outputs(outputs: Any, classes: tuple[str, ...]) -> None:
    """Refuse a model that has both classes and raw outputs, or neither of them."""
    if not isinstance(outputs, Mapping) or not all(
        isinstance(name, str) and isinstance(layer, str) for name, layer in outputs.items()
    ):
        raise ParameterTypeError("outputs", "must map names to names of layers", short(outputs))
    if not all(name and name.isprintable() for name in outputs):
        raise ParameterValueError("outputs", "must have names that can be printed", short(outputs))
    if not classes and not outputs:
        raise ParameterValueError("classes", "must hold at least one name, or `outputs` be given")
    if classes and outputs:
        rule = "are for a network of logits, and `outputs` for others: give one of them"
        raise ParameterValueError("classes", rule)


def _checked_shapes(
    network: Any,
    weights: Mapping[str, np.ndarray],
    config: TNTConfig,
    outputs: Mapping[str, str],
) -> dict[str, Shape]:
    """Check the layers of all networks.

    Returns
    -------
    Layer of the classifier -> the shape of its output.
    """
    is_mapping = isinstance(network, Mapping)
    if not is_mapping or not all(isinstance(layers, Sequence) for layers in network.values()):
        raise ParameterTypeError("network", "must map names to lists of layers", short(network))
    is_spiking = SPIKING in network
    expected = [SPIKING if is_spiking else CLASSIFIER]
    if config.needs_regressor:
        expected.append(REGRESSOR)
    if set(network) != set(expected):
        rule = f"must hold {', '.join(expected)} here"
        raise ParameterValueError("network", rule, ", ".join(sorted(network)))

    tensors = {name: w.shape for name, w in weights.items()}
    shapes = {}
    for name, layers in network.items():
        output_layers = list(outputs.values()) if outputs and name != REGRESSOR else None
        operations = SPIKING_OPERATIONS if name == SPIKING else OPERATIONS
        shapes[name] = layer_shapes(layers, config.shape, tensors, output_layers, operations)
    _check_centroids(network, shapes, config)
    _check_values(network, weights)
    if is_spiking:
        check_spiking_values(network[SPIKING], weights)
        check_spiking_outputs(network[SPIKING], outputs, config)
    return shapes[expected[0]]


def _check_logits(logits: Shape, n_classes: int, config: TNTConfig) -> None:
    """Refuse logits that are neither one number for each class nor a map.

    A map has a channel for each class, and then one for "no object here". Two more may say how
    large objects are, and two more where their middles are.
    """
    n_of_map = [n_classes + 1 + n for n in (0, *OF_BOXES)]
    is_map = len(logits) == 3 and logits[0] in n_of_map and logits[1:] != (1, 1)
    if logits not in ((n_classes,), (n_classes, 1, 1)) and not is_map:
        raise ValueError(
            f"the network must compute {n_classes} logits, one for each class, or a map of "
            f"{n_classes + 1} channels, one for each class and the last for nothing, or of "
            f"{n_classes + 3}, with two more for the width and height of objects, or of "
            f"{n_classes + 5}, with two more for their middles; got {logits}"
        )
    if is_map and config.transform != "none":
        raise ValueError(
            f"a map model needs transform='none', as a place of its map is one of the sensor; got "
            f"{config.transform!r}"
        )


def _check_centroids(
    network: Mapping[str, Any], shapes: Mapping[str, Any], config: TNTConfig
) -> None:
    """Refuse a centroid anywhere but at the end of the regressor, and a regressor without one.

    The centroid's heatmap must have the rows and columns of the volume.
    """
    all_layers = [layer for layers in network.values() for layer in layers]
    centroids = [layer for layer in all_layers if layer["op"] == CENTROID]
    expected = [network[REGRESSOR][-1]] if REGRESSOR in network else []
    if centroids != expected:
        raise ValueError(f"a {CENTROID} must be the last layer of a regressor, and nowhere else")
    volume = (1, *config.shape[1:])
    for layer in centroids:
        heatmap = shapes[REGRESSOR][layer["inputs"][0]]
        if heatmap != volume:
            raise ValueError(f"the heatmap must be of shape {volume}, as the volume, got {heatmap}")


def _check_values(network: Mapping[str, Any], weights: Mapping[str, np.ndarray]) -> None:
    """Refuse a weight that is not used or not finite, and a batch norm that divides by zero."""
    all_layers = [layer for layers in network.values() for layer in layers]
    unused = set(weights) - tensors_of(all_layers)
    if unused:
        raise ValueError(f"no layer has the weights {', '.join(sorted(unused))}")
    for name, w in weights.items():
        if not np.isfinite(w).all():
            raise ValueError(f"`{name}` must be finite numbers")
    for layer in all_layers:
        if layer["op"] == "batch_norm":
            variance = weights[layer["weights"]["variance"]]
            if not (variance + layer["epsilon"] > 0).all():
                raise ValueError(
                    f"layer {layer['name']!r} (batch_norm): variance + epsilon must be positive"
                )
