"""The thesis' experiment: which networks are trained, how, and which of them are compared.

All of this was fixed before the first network was trained.

A row is one way from events to a network's input, and what the network is trained on. All rows
share the network and the optimizer. The groups `thesis` and `long` have the thesis' own three rows.
The group `comparison` combines

- inputs: the event volume as it is (raw), or TNT about the image centre, the running centroid, a
  regressed landmark, or the fitted line with its flow removed,
- polarity: signed, unsigned or split,
- augmentation: windows are moved by up to 4 whole pixels, or not. In both cases events are thinned
  at random, which moves nothing. The thesis moves windows for its regressor alone, and does not say
  how far. Here windows are moved for all inputs, so that the comparison is fair.

In the comparison t_max is 2. Of 2, 3, 4 and 8, it has the lowest loss on held-out digits of the
training motion. The thesis has t_max = B - 1 = 8. Its own rows and some others have it here, too.

The thesis scales time from a window's first event to its last. Rows of the group `spans` do this,
over the whole saccade or over 1,000 events. The group `representations` has event images, and TNT
about `window`. The group `motions` has motion re-synthesis, an augmentation that the thesis does
not have. Its rows show what recordings of one motion can teach, not what a network infers by
itself. Its controls are trained for the same number of steps.

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
from experiments.thesis.versions import FLIPPED

T_MAX = 2.0
"""Scaled time at a window's end, in all rows but the thesis' own and those named "t8"."""

T_MAX_THESIS = 8.0
"""Scaled time at a window's end, in the thesis' rows and in those named "t8"."""

STEPS = 3_000
"""Steps of the optimizer in most rows."""

STEPS_MORE = 8_000
"""Steps of the optimizer in the thesis' rows and in those with re-synthesis and their controls."""

STEPS_THESIS = 60_000
"""Steps of the optimizer in the thesis, and in the rows of group `long`."""

ALL_EVENTS = 1_000_000
"""Span of a row whose windows keep all events. It is more than any window has."""

WINDOW_EVENTS = 1_000
"""Span of a row whose windows end after this number of events."""

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
    "center": TNTConfig(landmark="center", t_max=T_MAX),
    "running": TNTConfig(landmark="running", t_max=T_MAX),
    "regressor": TNTConfig(landmark="regressor", t_max=T_MAX),
    "line": TNTConfig(landmark="line", remove_flow=True, t_max=T_MAX),
}
"""Name of an input -> settings by which events become volumes."""

IMAGES: dict[Representation, str] = {
    "count": "image of counts",
    "count_time": "image of counts and times",
    "mean_time": "image of mean times",
    "time_surface": "time surface",
}
"""Representation of one image -> its title."""

CONTROLS = ("turned", "reversed", "flipped", "unsigned-8000", "all-ways")
"""Cheap ways to other directions: what stands behind "raw-" in the name of their rows."""

UNSIGNED = ("raw", "center", "running", "line")
"""Inputs that are also compared without the sign of polarity; raw first."""

SPLIT = ("raw", "running")
"""Inputs that are also compared with a volume for each polarity."""

TITLES = {"raw": "raw", **{name: f"`{name}`" for name in INPUTS if name != "raw"}}
"""Name of an input -> its title."""

COLUMNS = {
    "all/all": "trained on all three saccades, tested on all three",
    "1/all": "trained on the first saccade, tested on all three",
    "1/others": "trained on the first saccade, tested on the second and third",
    "1/train": "trained on the first saccade, tested on all three of the training digits",
    "confounded/all": (
        "trained on each digit in one saccade only (0-3: first, 4-6: second, 7-9: third), tested "
        "on all"
    ),
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
    versions : names of `versions.VERSIONS`: each window is also shown in these versions.
    span : number of events that a window keeps, its first ones. Their times are scaled to the whole
        window. None: a window keeps all events, and times are not scaled.
    seeds : largest number of the command's seeds with which the row is trained; None: all.
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
    span: int | None = None
    seeds: int | None = None


GROUPS = {
    "thesis": (
        "the thesis' rows, in windows of 105 ms: t_max 8, nothing thinned, translations with the "
        "regressor only"
    ),
    "long": "the same for 60,000 steps, as in the thesis, one seed",
    "comparison": (
        "raw volumes and TNT by landmark, signed, unsigned or split, translated or not; some with "
        "t_max 8"
    ),
    "spans": "time scaled from a window's first event to its last, as in the thesis",
    "motions": "with motion re-synthesis, an augmentation, and controls of as many steps",
    "representations": "event images instead of volumes, and TNT about `window`",
}
"""Group of rows -> what its rows have in common."""


def _thesis() -> Iterator[Row]:
    """The thesis' rows, for our number of steps and for its own."""
    translated = replace(AS_RECORDED, translate_px=TRANSLATE_PX)
    rows = (
        ("thesis-baseline", "Baseline", INPUTS["raw"], AS_RECORDED),
        ("thesis-tnt", "TNT", INPUTS["center"].replace(t_max=T_MAX_THESIS), AS_RECORDED),
        (
            "thesis-regress",
            "TNT+regress",
            INPUTS["regressor"].replace(t_max=T_MAX_THESIS),
            translated,
        ),
    )
    for name, title, config, augmentation in rows:
        yield Row(name, "thesis", title, config, augmentation, STEPS_MORE)
    for name, title, config, augmentation in rows:
        long = f"{title}, 60,000 steps"
        yield Row(f"{name}-60000", "long", long, config, augmentation, STEPS_THESIS, seeds=1)


def _compared(
    name: str,
    *,
    polarity: str = "signed",
    t_max: float = T_MAX,
    translated: bool = False,
) -> Row:
    """A row of the comparison. Its name and title tell which settings are not the usual ones."""
    config = INPUTS[name].replace(polarity=polarity)
    words = [name]
    title = [TITLES[name]]
    if t_max != T_MAX:
        config = config.replace(t_max=t_max)
        words.append(f"t{t_max:g}")
        title.append(f"t_max {t_max:g}")
    if polarity != "signed":
        words.append(polarity)
        title.append(polarity)
    if translated:
        words.append("translated")
        title.append("translated")
    return Row(
        "-".join(words),
        "comparison",
        ", ".join(title),
        config,
        replace(THINNED, translate_px=TRANSLATE_PX) if translated else THINNED,
        trained_on=("all", "1") if (polarity, t_max) == ("signed", T_MAX) else ("1",),
    )


def _comparison() -> Iterator[Row]:
    """The rows of the comparison: inputs by polarity, with and without translations."""
    for polarity, names in (("signed", INPUTS), ("unsigned", UNSIGNED), ("split", SPLIT)):
        for name in names:
            for translated in (False, True):
                yield _compared(name, polarity=polarity, translated=translated)
    for name in ("center", "running"):
        yield _compared(name, t_max=T_MAX_THESIS, translated=True)


def _spans() -> Iterator[Row]:
    """Rows whose time is scaled from a window's first event to its last."""
    for name, n, span_title in (
        ("raw", ALL_EVENTS, "from first event to last"),
        ("center", ALL_EVENTS, "from first event to last"),
        ("center", WINDOW_EVENTS, f"windows of {WINDOW_EVENTS:,} events"),
    ):
        suffix = "span" if n == ALL_EVENTS else f"{n}-events"
        yield Row(
            f"{name}-{suffix}", "spans", f"{TITLES[name]}, {span_title}", INPUTS[name], span=n
        )


def _motions() -> Iterator[Row]:
    """Rows with motion re-synthesis, and a control trained for the same number of steps."""
    row = partial(Row, group="motions", iterations=STEPS_MORE)
    yield row(
        name="raw-motions",
        title="raw + re-synthesis",
        config=INPUTS["raw"],
        trained_on=("all", "1"),
        motions=MotionSettings(),
    )
    yield row(
        name="running-motions",
        title="`running` + re-synthesis",
        config=INPUTS["running"],
        trained_on=("1",),
        motions=MotionSettings(),
    )
    yield row(
        name="raw-8000",
        title=f"raw, {STEPS_MORE:,} steps",
        config=INPUTS["raw"],
        trained_on=("all", "1", "confounded"),
    )
    yield row(
        name="raw-moved",
        title="raw, re-synthesis only",
        config=INPUTS["raw"],
        trained_on=("confounded",),
        motions=MotionSettings(recorded=0.0),
    )
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
    """Rows of TNT about `window` and of event images, all translated."""
    inputs = {"window": ("`window`", TNTConfig(landmark="window", t_max=T_MAX))}
    image_config = TNTConfig(transform="none", landmark="center", polarity="split")
    for image, title in IMAGES.items():
        inputs[image] = (title, image_config.replace(representation=image))
    translated = replace(THINNED, translate_px=TRANSLATE_PX)
    for name, (title, config) in inputs.items():
        row = f"{name}-translated"
        yield Row(row, "representations", f"{title}, translated", config, translated)


_PARTS = (_thesis, _comparison, _spans, _motions, _representations)
ROWS = {row.name: row for make in _PARTS for row in make()}
"""Name -> row, in the table's order."""
assert {row.group for row in ROWS.values()} == set(GROUPS)

QUESTIONS: dict[str, tuple[tuple[str, str], ...]] = {
    "The thesis' rows against its Baseline": (
        ("thesis-tnt", "thesis-baseline"),
        ("thesis-regress", "thesis-baseline"),
    ),
    "The transform against raw, not translated": tuple(
        (name, "raw") for name in INPUTS if name != "raw"
    ),
    "The transform against raw, translated": (
        *((f"{name}-translated", "raw-translated") for name in INPUTS if name != "raw"),
        ("window-translated", "raw-translated"),
    ),
    "The transform against raw, without the sign": tuple(
        (f"{name}-unsigned{moved}", f"raw-unsigned{moved}")
        for moved in ("", "-translated")
        for name in UNSIGNED[1:]  # all but raw
    ),
    "Polarity against signed": tuple(
        (f"{name}-{polarity}{moved}", f"{name}{moved}")
        for polarity, names in (("unsigned", UNSIGNED), ("split", SPLIT))
        for name in names
        for moved in ("", "-translated")
    ),
    "Windows moved by up to 4 px in training": (
        *((f"{name}-translated", name) for name in INPUTS),
        *((f"{name}-unsigned-translated", f"{name}-unsigned") for name in UNSIGNED),
    ),
    "t_max 8 against 2": tuple(
        (f"{name}-t8-translated", f"{name}-translated") for name in ("center", "running")
    ),
    "Time from first event to last": (
        ("raw-span", "raw"),
        ("center-span", "center"),
        (f"center-{WINDOW_EVENTS}-events", "center"),
        ("center-span", "raw-span"),
    ),
    "Event images against raw": tuple((f"{name}-translated", "raw-translated") for name in IMAGES),
    "Re-synthesis against as many steps without": (
        ("raw-motions", "raw-8000"),
        ("raw-moved", "raw-8000"),
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
        for place, seed in enumerate(seeds):
            for row in rows:
                if row.seeds is None or place < row.seeds:
                    runs += [
                        Run(row.name, training_set, seed)
                        for training_set in row.trained_on
                        if training_set in trained_on
                    ]
    return runs
