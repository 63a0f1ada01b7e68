"""The thesis' experiment: which networks are trained, how, and which of them are compared. All was set beforehand.

A row is one way from events to a network's input, and what it is trained on. All rows share the network and the
optimizer. The comparison crosses

- the input: the event volume as it is (raw), or TNT about the image centre, the running centroid, a regressed
  landmark, or the fitted line with its flow removed,
- polarity: signed or not,
- augmentation: events are thinned at random, which moves nothing, and windows are moved by up to 4 whole pixels or
  not. The thesis moves them (it names no size) for its regressor alone; what one row may have, every row may have.

t_max is 2 there: of 2, 3, 4 and 8 the one with the lowest loss on held-out digits of the training motion
(docs/results.md has the numbers). The thesis has B - 1 = 8, which other rows have.

Besides: the thesis' own three rows; event images and TNT about `window`; rows that learn from fewer recordings; and
rows with motion re-synthesis (`resynthesis`), an augmentation that the thesis does not have. They show what recordings
of one motion can teach, not what a network infers by itself.

References
----------
Wang 2019, arXiv:1911.12801, the table of N-MNIST and N-MOVING-MNIST: the numbers in `THESIS`. "1/train" there: trained
on the first saccade, tested on all three saccades of the training digits.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from async_tnt.config import Representation, TNTConfig
from async_tnt.training.augment import Augmentation
from async_tnt.training.moved_windows import MotionSettings

T_MAX = 2.0
T_MAX_THESIS = 8.0
STEPS, STEPS_MOTIONS, STEPS_THESIS = 3_000, 8_000, 60_000
TRANSLATE_PX = 4
AS_RECORDED = Augmentation(start_ms=0, shift_px=0, rotation_deg=0, scale=0, shear=0, drop=0, partial=0)
THINNED = replace(AS_RECORDED, drop=0.3)

INPUTS = {
    "raw": TNTConfig(transform="none", landmark="center"),
    "center": TNTConfig(landmark="center", t_max=T_MAX),
    "running": TNTConfig(landmark="running", t_max=T_MAX),
    "regressor": TNTConfig(landmark="regressor", t_max=T_MAX),
    "line": TNTConfig(landmark="line", remove_flow=True, t_max=T_MAX),
}
IMAGES: dict[Representation, str] = {
    "count": "image of counts",
    "count_time": "image of counts and times",
    "mean_time": "image of mean times",
    "time_surface": "time surface",
}
TITLES = {"raw": "raw", **{name: f"`{name}`" for name in INPUTS if name != "raw"}}

COLUMNS = {
    "all/all": "trained on all three saccades, tested on all three",
    "1/all": "trained on the first saccade, tested on all three",
    "1/others": "trained on the first saccade, tested on the second and third",
    "1/train": "trained on the first saccade, tested on all three of the training digits",
    "all/sim": "trained on all three saccades, tested on 30 simulated motions",
    "1/sim": "trained on the first saccade, tested on 30 simulated motions",
    "confounded/all": "trained on each digit in one saccade only (0-3: first, 4-6: second, 7-9: third), tested on all",
    "confounded/sim": "the same, tested on 30 simulated motions",
}
TRAINED_ON = tuple(dict.fromkeys(column.split("/")[0] for column in COLUMNS))
THESIS = {
    "thesis-baseline": {"all/all": 0.991, "1/all": 0.437, "1/train": 0.442, "all/sim": 0.396, "1/sim": 0.207},
    "thesis-tnt": {"all/all": 0.981, "1/all": 0.468, "1/train": 0.464, "all/sim": 0.592, "1/sim": 0.318},
    "thesis-regress": {"all/all": 0.981, "1/all": 0.485, "1/train": 0.481, "all/sim": 0.566, "1/sim": 0.324},
}
"""The thesis' accuracies: row -> column."""


@dataclass(frozen=True)
class Row:
    """One way from events to a network's input, and what it is trained on.

    Parameters
    ----------
    name : for the command line and for files.
    group : of `GROUPS`.
    title : in the table.
    config : how events become volumes.
    augmentation : of the training windows.
    iterations : steps of the optimizer.
    trained_on : of `TRAINED_ON`.
    motions : how the windows are re-synthesized; None: they are not.
    recordings : how many recordings are trained on; None: all.
    seeds : with how many of the command's seeds, at most; None: all.
    """

    name: str
    group: str
    title: str
    config: TNTConfig
    augmentation: Augmentation = THINNED
    iterations: int = STEPS
    trained_on: tuple[str, ...] = ("all", "1")
    motions: MotionSettings | None = None
    recordings: int | None = None
    seeds: int | None = None


GROUPS = {
    "comparison": "raw volumes and TNT by landmark, signed or not, translated or not; some with t_max 4 or 8",
    "motions": "with motion re-synthesis, an augmentation",
    "learning": "from fewer recordings",
    "representations": "event images instead of volumes, and TNT about `window`",
    "thesis": "the thesis' own rows: t_max 8, nothing thinned, translations with the regressor only, 60,000 steps",
}


def _row(
    name: str,
    *,
    polarity: str = "signed",
    t_max: float = T_MAX,
    translated: bool = False,
    recordings: int | None = None,
) -> Row:
    """A row of the comparison, or of fewer recordings; its name and title tell what is not usual."""
    config, words, title = INPUTS[name].replace(polarity=polarity), [name], [TITLES[name]]
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
    if recordings is not None:
        words.append(str(recordings))
        title.append(f"{recordings:,} recordings")
    usual = (polarity, t_max, recordings) == ("signed", T_MAX, None)
    return Row(
        "-".join(words),
        "comparison" if recordings is None else "learning",
        ", ".join(title),
        config,
        replace(THINNED, translate_px=TRANSLATE_PX) if translated else THINNED,
        trained_on=("all", "1") if usual else ("1",),
        recordings=recordings,
    )


def _comparison() -> Iterator[Row]:
    for name in INPUTS:
        for polarity in ("signed", "unsigned"):
            for translated in (False, True):
                yield _row(name, polarity=polarity, translated=translated)
    yield _row("running", t_max=4.0, translated=True)
    for name in ("center", "running", "regressor"):
        yield _row(name, t_max=T_MAX_THESIS, translated=True)


def _motions() -> Iterator[Row]:
    for name, title, config, motions, trained_on in (
        ("raw-motions", "raw + re-synthesis", INPUTS["raw"], MotionSettings(), ("all", "1")),
        ("running-motions", "`running` + re-synthesis", INPUTS["running"], MotionSettings(), ("all", "1")),
        ("raw-moved", "raw, re-synthesis only", INPUTS["raw"], MotionSettings(recorded=0.0), ("confounded",)),
        ("raw-confounded", "raw", INPUTS["raw"], None, ("confounded",)),
    ):
        yield Row(name, "motions", title, config, iterations=STEPS_MOTIONS, trained_on=trained_on, motions=motions)


def _learning() -> Iterator[Row]:
    for name in ("raw", "running"):
        for recordings in (700, 2_000):
            yield _row(name, translated=True, recordings=recordings)


def _representations() -> Iterator[Row]:
    inputs = {"window": ("`window`", TNTConfig(landmark="window", t_max=T_MAX))}
    for image, title in IMAGES.items():
        config = TNTConfig(representation=image, transform="none", landmark="center", polarity="split")
        inputs[image] = title, config
    augmentation = replace(THINNED, translate_px=TRANSLATE_PX)
    for name, (title, config) in inputs.items():
        yield Row(f"{name}-translated", "representations", f"{title}, translated", config, augmentation)


def _thesis() -> Iterator[Row]:
    for name, title, of, augmentation in (
        ("thesis-baseline", "Baseline", "raw", AS_RECORDED),
        ("thesis-tnt", "TNT", "center", AS_RECORDED),
        ("thesis-regress", "TNT+regress", "regressor", replace(AS_RECORDED, translate_px=TRANSLATE_PX)),
    ):
        config = INPUTS[of] if of == "raw" else INPUTS[of].replace(t_max=T_MAX_THESIS)
        yield Row(name, "thesis", title, config, augmentation, STEPS_THESIS, seeds=1)


_PARTS = (_comparison, _motions, _learning, _representations, _thesis)
ROWS = {row.name: row for make in _PARTS for row in make()}
assert {row.group for row in ROWS.values()} == set(GROUPS)

DIFFERENCES = (
    *((f"{name}-translated", name) for name in INPUTS),
    *((f"{name}-unsigned", name) for name in INPUTS),
    *((f"{name}-unsigned-translated", f"{name}-translated") for name in INPUTS),
    *((f"{name}-translated", "raw-translated") for name in INPUTS if name != "raw"),
    *((f"{name}-unsigned-translated", "raw-unsigned-translated") for name in INPUTS if name != "raw"),
    ("running-translated", "center-translated"),
    ("running-translated", "regressor-translated"),
    ("line-unsigned-translated", "running-unsigned-translated"),
    ("running-t4-translated", "running-translated"),
    *((f"{name}-t8-translated", f"{name}-translated") for name in ("center", "running", "regressor")),
    *((f"{name}-translated", "raw-translated") for name in ("window", *IMAGES)),
    ("running-motions", "raw-motions"),
    ("raw-moved", "raw-confounded"),
)
"""Pairs of rows whose difference in accuracy is looked at: (row, against)."""


@dataclass(frozen=True)
class Run:
    """Which network: a row, what it is trained on, and a seed."""

    row: str
    trained_on: str
    seed: int

    @property
    def name(self) -> str:
        return f"{self.row}-{self.trained_on}-seed{self.seed}"


def runs_of(names: Iterable[str], trained_on: Collection[str], seeds: Sequence[int]) -> list[Run]:
    """The networks of rows or groups, in the order they are trained: group by group, seed by seed.

    Parameters
    ----------
    names : of `ROWS` and `GROUPS`.
    trained_on : of `TRAINED_ON`; others are left out.
    """
    names = set(names)
    return [
        Run(row.name, on, seed)
        for group in GROUPS
        for place, seed in enumerate(seeds)
        for row in ROWS.values()
        if row.group == group and names & {row.name, group} and (row.seeds is None or place < row.seeds)
        for on in row.trained_on
        if on in trained_on
    ]
