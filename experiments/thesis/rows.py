"""The thesis' experiment: which networks are trained, how, and which of them are compared.

All of this was fixed before the first network was trained.

A row is one way from events to a network's input, and what the network is trained on. All rows
share the network and the optimizer.

- `thesis` has the thesis' own rows. As in the thesis, t_max is B - 1 = 8, and time is scaled from a
  window's first event to its last.
- `comparison` has the event volume as it is (raw), and TNT about the running centroid and about the
  fitted line with its flow removed. Windows are moved by up to 4 whole pixels in training, or not.
  In both cases events are thinned at random, which moves nothing. The thesis moves windows for its
  regressor alone, and does not say how far. Here windows are moved for all inputs, so that the
  comparison is fair.
- `t_max` has other values of t_max than the comparison, for the loss on held-out digits of the
  training motion. Its networks are not tested.
- `motions` has motion re-synthesis, an augmentation that the thesis does not have. Its rows show
  what recordings of one motion can teach, not what a network infers by itself. Its controls are
  cheap ways to other directions, with the same number of steps.
- `representations` has event images instead of volumes.

References
----------
Wang 2019, arXiv:1911.12801, the table of N-MNIST and N-MOVING-MNIST has the numbers in `THESIS`.
Its "1/train" means: trained on the first saccade, tested on all three saccades of the training
digits.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from async_tnt import TNTConfig
from async_tnt.training.augment import Augmentation
from async_tnt.training.moved_windows import MotionSettings
from async_tnt.volume.config import Representation
from experiments.motions.versions import FLIPPED

T_MAX = 2.0
"""Scaled time at a window's end, in all rows but the thesis' own and those of the group `t_max`."""

T_MAX_THESIS = 8.0
"""Scaled time at a window's end, in the thesis' rows."""

T_MAX_TRIED = (3.0, 4.0, 8.0)
"""Values of t_max that were tried besides `T_MAX`."""

STEPS = 3_000
"""Steps of the optimizer in most rows."""

STEPS_MORE = 8_000
"""Steps of the optimizer in the thesis' rows and in those with re-synthesis and their controls. The
thesis has 60,000."""

TRANSLATE_PX = 4
"""Largest translation of a training window, in pixels."""

AS_RECORDED = Augmentation(
    start_ms=0, shift_px=0, rotation_deg=0, scale=0, shear=0, drop=0, partial=0
)
"""Augmentation that leaves training windows as they are."""

THINNED = replace(AS_RECORDED, drop=0.3)
"""Augmentation that drops up to 30 % of a training window's events, and nothing else."""

INPUTS = {
    "raw": TNTConfig(transform="none", landmark="center"),
    "running": TNTConfig(landmark="running", t_max=T_MAX),
    "line": TNTConfig(landmark="line", remove_flow=True, t_max=T_MAX),
}
"""Name of an input of the comparison -> settings by which events become volumes."""

THESIS_INPUTS = {
    "thesis-baseline": ("Baseline", INPUTS["raw"]),
    "thesis-tnt": ("TNT", TNTConfig(landmark="center", t_max=T_MAX_THESIS)),
    "thesis-regress": ("TNT+regress", TNTConfig(landmark="regressor", t_max=T_MAX_THESIS)),
}
"""Row of the thesis -> its title, and the settings by which events become volumes."""

IMAGES: dict[Representation, str] = {
    "count": "image of counts",
    "count_time": "image of counts and times",
    "mean_time": "image of mean times",
    "time_surface": "time surface",
}
"""Representation of one image -> its title."""

CONTROLS = ("turned", "reversed", "flipped", "unsigned-8000", "all-ways")
"""Cheap ways to other directions: what stands behind "raw-" in the name of their rows."""

TITLES = {name: name if name == "raw" else f"`{name}`" for name in INPUTS}
"""Name of an input -> its title."""

COLUMNS = {
    "all/all": "trained on all three saccades, tested on all three",
    "1/all": "trained on the first saccade, tested on all three",
    "1/others": "trained on the first saccade, tested on the second and third",
    "1/train": "trained on the first saccade, tested on all three of the training digits",
}
"""Tests on recordings. Every network is tested on each of `SETS`, too: "all/sim", "1/bell" ..."""

TRAINED_ON = tuple(dict.fromkeys(column.split("/")[0] for column in COLUMNS))
"""What a network may be trained on."""

SETS = {
    "sim": ("constant", True),
    "centre": ("constant-from-centre", True),
    "bell": ("bell", True),
    "bell centre": ("bell-from-centre", True),
    "beyond": ("beyond", True),
    "sim bright": ("constant", False),
    "centre bright": ("constant-from-centre", False),
    "bell bright": ("bell", False),
    "bell centre bright": ("bell-from-centre", False),
}
"""Simulated set -> its kind of motions, of `motions.kinds.KINDS`, and whether its digits are dark
on a bright background."""

FOREIGN = "sim v2e"
"""The set whose motions are those of "sim", but whose pixels are those of v2e, which are not ours
(`moving_set/foreign_pixels.py`). It is there if a checkout of v2e is given."""

THESIS_SET = "centre bright"
"""The set that is probably like the thesis' own."""

THESIS = {
    "thesis-baseline": {
        "all/all": 0.991,
        "1/all": 0.437,
        "1/train": 0.442,
        f"all/{THESIS_SET}": 0.396,
        f"1/{THESIS_SET}": 0.207,
    },
    "thesis-tnt": {
        "all/all": 0.981,
        "1/all": 0.468,
        "1/train": 0.464,
        f"all/{THESIS_SET}": 0.592,
        f"1/{THESIS_SET}": 0.318,
    },
    "thesis-regress": {
        "all/all": 0.981,
        "1/all": 0.485,
        "1/train": 0.481,
        f"all/{THESIS_SET}": 0.566,
        f"1/{THESIS_SET}": 0.324,
    },
}
"""The thesis' accuracies, by row and column. Its columns all/sim and 1/sim are those of
`THESIS_SET` here."""


@dataclass(frozen=True)
class Row:
    """One way from events to a network's input, and what the network is trained on.

    Parameters
    ----------
    name : name on the command line and in files.
    group : one of `GROUPS`.
    title : title in the table.
    config : settings by which events become volumes.
    augmentation : augmentation of the training windows.
    iterations : steps of the optimizer.
    trained_on : names of `TRAINED_ON`.
    motions : settings of motion re-synthesis; None: windows are not re-synthesized.
    versions : names of `motions.versions.VERSIONS`: each window is also shown in these versions.
    is_scaled : whether time is scaled from a window's first event to its last.
    is_tested : whether the networks are tested. Otherwise they are only validated.
    """

    name: str
    group: str
    title: str
    config: TNTConfig
    augmentation: Augmentation = THINNED
    iterations: int = STEPS
    trained_on: tuple[str, ...] = ("all", "1")
    motions: MotionSettings | None = None
    versions: tuple[str, ...] = ()
    is_scaled: bool = False
    is_tested: bool = True


GROUPS = {
    "thesis": (
        "the thesis' rows: t_max 8, time from first event to last, nothing thinned, translations "
        "with the regressor only"
    ),
    "comparison": "raw volumes and TNT by landmark, translated or not, t_max 2",
    "t_max": "other values of t_max: TNT about the running centroid, validated only",
    "motions": "with motion re-synthesis, an augmentation, and controls of as many steps",
    "representations": "event images instead of volumes",
}
"""Group of rows -> what its rows have in common."""


def _thesis() -> Iterator[Row]:
    """The thesis' rows."""
    translated = replace(AS_RECORDED, translate_px=TRANSLATE_PX)
    for name, (title, config) in THESIS_INPUTS.items():
        augmentation = translated if name == "thesis-regress" else AS_RECORDED
        yield Row(name, "thesis", title, config, augmentation, STEPS_MORE, is_scaled=True)


def _comparison() -> Iterator[Row]:
    """The rows of the comparison: inputs with and without translations."""
    moved = replace(THINNED, translate_px=TRANSLATE_PX)
    for name, config in INPUTS.items():
        yield Row(name, "comparison", TITLES[name], config)
        title = f"{TITLES[name]}, translated"
        yield Row(f"{name}-translated", "comparison", title, config, moved)


def _t_max() -> Iterator[Row]:
    """Rows that differ from `running` in t_max only."""
    for t_max in T_MAX_TRIED:
        yield Row(
            f"running-t{t_max:g}",
            "t_max",
            f"`running`, t_max {t_max:g}",
            INPUTS["running"].replace(t_max=t_max),
            trained_on=("1",),
            is_tested=False,
        )


def _motions() -> Iterator[Row]:
    """Rows with motion re-synthesis, and controls trained for the same number of steps."""
    row = partial(Row, group="motions", iterations=STEPS_MORE)
    yield row(
        name="raw-motions",
        title="raw + re-synthesis",
        config=INPUTS["raw"],
        motions=MotionSettings(),
    )
    yield row(
        name="running-motions",
        title="`running` + re-synthesis",
        config=INPUTS["running"],
        trained_on=("1",),
        motions=MotionSettings(),
    )
    yield row(name="raw-8000", title=f"raw, {STEPS_MORE:,} steps", config=INPUTS["raw"])
    yield from _controls(row)


def _controls(row: Callable[..., Row]) -> Iterator[Row]:
    """Rows with cheap ways to other directions, as many steps as with re-synthesis.

    row : makes a row of the group.
    """
    turned = replace(THINNED, rotation_deg=180)
    unsigned = INPUTS["raw"].replace(polarity="unsigned")
    ways: dict[str, tuple[str, dict[str, Any]]] = {
        "turned": ("raw, turned by any angle", {"augmentation": turned}),
        "reversed": ("raw, reversed in time, too", {"versions": ("reversed",)}),
        "flipped": ("raw, flipped, too", {"versions": FLIPPED}),
        "unsigned-8000": ("raw, unsigned", {"config": unsigned}),
        "all-ways": (
            "raw, unsigned, turned, reversed and flipped",
            {"config": unsigned, "augmentation": turned, "versions": (*FLIPPED, "reversed")},
        ),
    }
    for name, (title, settings) in ways.items():
        yield row(
            name=f"raw-{name}",
            title=title,
            trained_on=("1",),
            **{"config": INPUTS["raw"], **settings},
        )


def _representations() -> Iterator[Row]:
    """Rows of event images, translated."""
    image_config = TNTConfig(transform="none", landmark="center", polarity="split")
    translated = replace(THINNED, translate_px=TRANSLATE_PX)
    for image, title in IMAGES.items():
        yield Row(
            f"{image}-translated",
            "representations",
            f"{title}, translated",
            image_config.replace(representation=image),
            translated,
        )


_PARTS = (_thesis, _comparison, _t_max, _motions, _representations)
ROWS = {row.name: row for make in _PARTS for row in make()}
"""Name -> row, in the table's order."""
assert {row.group for row in ROWS.values()} == set(GROUPS)

QUESTIONS: dict[str, tuple[tuple[str, str], ...]] = {
    "The thesis' rows against its Baseline": (
        ("thesis-tnt", "thesis-baseline"),
        ("thesis-regress", "thesis-baseline"),
    ),
    "The transform against raw, not translated": (("running", "raw"), ("line", "raw")),
    "The transform against raw, translated": (
        ("running-translated", "raw-translated"),
        ("line-translated", "raw-translated"),
    ),
    "Windows moved by up to 4 px in training": tuple(
        (f"{name}-translated", name) for name in INPUTS
    ),
    "Event images against raw": tuple((f"{name}-translated", "raw-translated") for name in IMAGES),
    "Re-synthesis against as many steps without": (
        ("raw-motions", "raw-8000"),
        ("running-motions", "raw-motions"),
    ),
    "Cheap ways to other directions against as many steps without": tuple(
        (f"raw-{name}", "raw-8000") for name in CONTROLS
    ),
    "Re-synthesis against cheap ways to other directions": tuple(
        ("raw-motions", f"raw-{name}") for name in CONTROLS
    ),
}
"""Question -> pairs (row, against) of rows. The difference of their accuracies is measured in every
column that both have."""


@dataclass(frozen=True)
class Run:
    """A network: its row, what it is trained on, and its seed."""

    row: str
    trained_on: str
    seed: int

    @property
    def name(self) -> str:
        return f"{self.row}-{self.trained_on}-seed{self.seed}"


def runs_of(names: Iterable[str], trained_on: Collection[str], seeds: Sequence[int]) -> list[Run]:
    """The networks of rows or groups, in the order of training: group by group, seed by seed.

    Parameters
    ----------
    names : names of `ROWS` and `GROUPS`.
    trained_on : names of `TRAINED_ON`. Networks that are trained on anything else are left out.
    """
    names = set(names)
    runs = []
    for group in GROUPS:
        rows = [row for row in ROWS.values() if row.group == group and names & {row.name, group}]
        for seed in seeds:
            for row in rows:
                runs += [
                    Run(row.name, training_set, seed)
                    for training_set in row.trained_on
                    if training_set in trained_on
                ]
    return runs
