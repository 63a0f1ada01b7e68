"""The compiled networks of a model: the classifier and the landmark regressor.

The classifier computes only what has changed.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.running import Running, one_at_a_time
from async_tnt.kernels.decisions.classify import absorb_and_decide, classify_cells
from async_tnt.kernels.decisions.objects import locate_cells, score_map
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.network.heatmap import centroid
from async_tnt.kernels.network.program import EPOCH, OUTPUT_DY
from async_tnt.networks.layers.graph import CLASSIFIER, REGRESSOR
from async_tnt.networks.layers.program import Program, VolumeInput, make_program
from async_tnt.networks.models.model import Model, layers_of
from async_tnt.networks.models.objects import ObjectReader, new_tracks
from async_tnt.volume.events import Columns
from async_tnt.volume.volume import TNTVolume

_packed_weights: WeakKeyDictionary[Model, dict[str, dict[str, np.ndarray]]] = WeakKeyDictionary()
"""Model -> name of a network -> its packed weights, which all programs of the model share."""


def program_of(model: Model, network: str) -> Program:
    """A new program of a model's classifier or regressor, with feature maps of its own."""
    networks = _packed_weights.setdefault(model, {})
    shared = networks.setdefault(network, {})
    outputs = None
    if network == CLASSIFIER and model.outputs:
        outputs = list(model.outputs.values())
    layers = layers_of(model, network)
    return make_program(layers, model.config.shape, model.weights, shared, outputs)


class CompiledClassifier:
    """The compiled network of a model: volume (C, H, W) -> logits.

    The logits have the shape (n_classes,), or (n_classes + 1, R, C) for a map model. They equal
    torch's logits within 1e-4. A call with an array computes the whole network. `refresh` computes
    only what has changed in a volume since the last call. Both give the same logits, bit for bit.
    An instance holds its feature maps: use one instance per thread.

    Parameters
    ----------
    model : a Model with `classes`.

    Attributes
    ----------
    shape : (C, H, W) of the volumes.
    n_classes : number of classes.
    sensor : (width, height).
    places : where on the sensor the places of a map model's map lie; None for other models.
    network : the arrays that compiled code reads, see `kernels.network.program`.
    steps : for each step of the program, the name of the layer that it computes or belongs to.

    Raises
    ------
    ValueError : the model has raw outputs; or, in a call, the volume's shape is not the model's.
    RuntimeError : in a call, another call is running.

    Examples
    --------
    >>> from async_tnt import TNTVolume, load_model
    >>> model = load_model("digits")
    >>> network = CompiledClassifier(model)
    >>> volume = TNTVolume(model.config)
    >>> for t in range(1, 100):
    ...     _ = volume.update_one(t, t % 34, 17, 1)
    ...     assert (network.refresh(volume) == CompiledClassifier(model)(volume.array)).all()
    """

    def __init__(self, model: Model) -> None:
        if model.outputs:
            rule = "must have classes; CompiledNetwork(model) is for models of raw outputs"
            raise ParameterValueError("model", rule)
        self.shape = model.config.shape
        self.n_classes = len(model.classes)
        self.places = model.places
        self.sensor = model.config.sensor
        self._running = Running("CompiledClassifier")
        self._program = program_of(model, CLASSIFIER)
        self.network = self._program.arrays
        self.steps = self._program.steps
        self._input = VolumeInput(self.shape)
        self.logits_shape = model.logits_shape
        self.reader: ObjectReader | None = None
        if self.places is not None:
            self.reader = ObjectReader(self.logits_shape, self.n_classes, *self._program.outputs[0])
        self._prepare()

    def _prepare(self) -> None:
        """Compile the kernel that decides, so that no event waits for the compiler."""
        prepare(classify_cells if self.places is None else locate_cells)

    def prepare_stretches(self) -> None:
        """Compile the kernel of `decide_stretch`."""
        prepare(absorb_and_decide)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        vars(self).pop("map", None)  # it is a view of the original's memory
        # The copied number names a window of the original's process. In this process it may name
        # another window.
        self.network.program[EPOCH] = 0
        self._prepare()

    @one_at_a_time
    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """The logits of one volume, a new array: float32, (n_classes,) or (n_classes + 1, R, C)."""
        logits = self._program.run(self._input(volume))
        if self.reader is None:
            return logits[: self.n_classes].copy()
        about, scores, peaks, *_ = self.reader.arrays
        score_map.call(self.network.maps, about, scores, peaks)
        return self.map.copy()

    def refresh(self, volume: TNTVolume) -> np.ndarray:
        """The logits of a volume's open window, a new array.

        The call is quick if little has changed since the last call.

        Parameters
        ----------
        volume : a TNTVolume of the model's shape; it may be another one than in the last call.

        Returns
        -------
        float32, shape (n_classes,) or (n_classes + 1, R, C).

        Raises
        ------
        ValueError : the volume has another shape.
        """
        if volume.config.shape != self.shape:
            raise ParameterValueError(
                "volume", f"must have shape {self.shape}", volume.config.shape
            )
        if self.places is None:
            return self.answer(volume)[1]
        self.locate(volume, new_tracks(self.places, self.logits_shape, 0), 0, False)
        return self.map.copy()

    @cached_property  # made once: making a view takes as long as running a small network
    def map(self) -> np.ndarray:
        """A map model's last map, (n_classes + 1, R, C), read-only; the next call changes it."""
        return self._program.view(0, self.logits_shape)

    def answer(self, volume: TNTVolume) -> tuple[int, np.ndarray, np.ndarray]:
        """The class, logits and probabilities of a volume's open window.

        This is `refresh` for a volume whose shape is known to fit.

        Returns
        -------
        The class, or -1 if a logit is not finite; the logits; the probabilities, float64, shape
        (n_classes,).
        """
        logits = np.empty(self.n_classes, np.float32)
        probabilities = np.empty(self.n_classes)
        self._running.begin()
        try:
            index = classify_cells.call(volume.state(), *self.network, logits, probabilities)
            return index, logits, probabilities
        finally:
            self._running.now = False

    @one_at_a_time
    def locate(self, volume: TNTVolume, tracks: np.ndarray, time_us: int, keep: bool) -> int:
        """The number of objects on a map model's map, or -1 if a logit is not finite.

        This is `answer` for a map model. `reader` then holds the objects.

        Parameters
        ----------
        tracks, time_us, keep : see `kernels.decisions.objects.locate_on_map`.
        """
        assert self.reader is not None
        n: int = locate_cells.call(
            volume.state(), *self.network, *self.reader.arrays, tracks, time_us, keep
        )
        return n

    @one_at_a_time
    def decide_stretch(
        self,
        buffer: np.ndarray,
        columns: Columns,
        first: int,
        last: int,
        trigger: np.ndarray,
        *answers: np.ndarray,
    ) -> tuple[int, int, int]:
        """Absorb events and decide, in one compiled call.

        See `kernels.decisions.classify.absorb_and_decide`.

        Parameters
        ----------
        answers : the kernel's arrays for logits, probabilities and notes.
        """
        result: tuple[int, int, int]
        result = absorb_and_decide.call(
            buffer, *columns[:4], first, last, trigger, *self.network, *answers
        )
        return result


class CompiledRegressor:
    """The compiled landmark network of a model.

    It computes a landmark (x, y) in grid pixels from a raw volume (C, H, W).

    The network's last map is a heatmap. The landmark is the centroid of the heatmap's exponential,
    computed in float64. It equals torch's landmark within 1e-4 pixels. `Processor(model)` makes its
    own regressor. Without a Processor, pass a regressor to the volume: `TNTVolume(model.config,
    regressor=CompiledRegressor(model))`. A regressor holds scratch memory: use one instance per
    thread.

    Parameters
    ----------
    model : a Model with landmark `regressor`.

    Attributes
    ----------
    shape : (C, H, W) of the volumes.

    Raises
    ------
    ValueError : the model has no regressor; or, in a call, the volume's shape is not the model's.
    RuntimeError : in a call, another call is running.
    """

    def __init__(self, model: Model) -> None:
        config = model.config
        if not config.needs_regressor:
            raise ValueError(
                'the model has no regressor: that needs landmark="regressor" and transform="tnt", '
                f"got landmark={config.landmark!r}, transform={config.transform!r}"
            )
        self.shape = config.shape
        self._running = Running("CompiledRegressor")
        self._program = program_of(model, REGRESSOR)
        self._input = VolumeInput(self.shape)
        self._prepare()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._prepare()  # this may be another process, which has not compiled them yet

    def _prepare(self) -> None:
        """Compile the kernels, so that no window waits for the compiler."""
        self._program.prepare()
        prepare(centroid)

    @one_at_a_time
    def __call__(self, volume: np.ndarray) -> tuple[float, float]:
        """The landmark of one raw volume, float64.

        It is nan if the network's float32 numbers overflow.
        """
        exponent = self._program.run(self._input(volume))
        _, height, width = self.shape
        x, y = centroid.call(exponent, int(self._program.arrays.program[OUTPUT_DY]), width, height)
        return x, y
