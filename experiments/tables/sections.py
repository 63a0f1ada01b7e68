"""What stands in RESULTS.md: the sections, how their tables were measured, and what each table
shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from experiments.tables import accuracy, datasets, decisions, differences, streams, thesis
from experiments.tables.texts import (
    CARS,
    DEFAULT,
    EVERYWHERE,
    FEW,
    FROM_PICTURES,
    INPUTS,
    MOTIONS,
    RECIPE,
    SIMULATED,
    THESIS,
)
from experiments.thesis.rows import THESIS_SET

Table = Callable[[], str]


@dataclass(frozen=True)
class Section:
    """A section of RESULTS.md.

    Parameters
    ----------
    title : its heading.
    text : how it was measured, and what limits the numbers; Markdown.
    command : what repeats it, without `python -m`; "" if nothing does.
    tables : a table -> what it shows.
    picture : name of a picture in docs/images.
    """

    title: str
    text: str
    command: str = ""
    tables: dict[Table, str] = field(default_factory=dict)
    picture: str = ""


SECTIONS = (
    Section(
        "Decisions",
        "What is compared runs in one process, on one thread each, warm, taking turns, and must "
        "first give the same "
        "logits within 1e-4, but for eventcv, whose volume is another one. *In blocks*: 50 "
        "decisions in a row, so "
        "that each network has the caches to itself. *Call by call*: the networks alternate at "
        "every decision. Ratios "
        "are taken pair by pair. Latency is wall-clock time, throughput processor time. OpenVINO "
        "uses float32 and the "
        "hint LATENCY.",
        "experiments.decisions --json experiments/results/decisions.json --picture "
        "docs/images/decisions.png",
        {
            decisions.decisions_machine: "Machine",
            decisions.network_in_blocks: "The network alone, in blocks: microseconds from a finished volume to its "
            "logits, 99th percentile, ratio to the incremental one",
            decisions.network_call_by_call: "The network alone, call by call",
            decisions.end_to_end_in_blocks: "From a packet to the decision, in blocks",
            decisions.end_to_end_call_by_call: "From a packet to the decision, call by call",
            decisions.every_event: "A decision after every event, recordings in packets of 1,000 events",
        },
    ),
    Section(
        "Starts",
        "A fresh process, to its first decision. A `Processor` compiles in its own process, "
        "commands compile in two.",
        "experiments.starts --json experiments/results/starts.json",
        {decisions.starts_machine: "Machine", decisions.starts: "Seconds, medians of five"},
    ),
    Section(
        "Four networks",
        "Random weights, on the bundled recordings, whose pixels are mapped onto each grid: that "
        "of the thesis; "
        "`conv4`, four convolutions with batch norm and max pooling; `residual`; and one for "
        "gestures, a 2x2 stem of "
        "stride 2 and four 3x3 convolutions with average pooling.",
        "experiments.incremental --json experiments/results/incremental.json --picture "
        "docs/images/incremental.png",
        {
            decisions.incremental_machine: "Machine",
            decisions.incremental_times: "Microseconds from a finished volume to its logits, in blocks, 99th "
            "percentile, ratio to the incremental one",
            decisions.incremental_work: "Multiplications, memory, and a decision after every event",
        },
        picture="incremental",
    ),
    Section(
        "Events into a volume",
        "Landmark `running`, 8 cells, transform included; random events.",
        "experiments.volumes --json experiments/results/bench.json",
        {streams.volumes: "By the size of a packet"},
    ),
    Section(
        "Memory",
        "",
        "experiments.memory --json experiments/results/memory.json",
        {streams.memory: "Growth of a long stream"},
    ),
    Section(
        "Cars",
        CARS,
        "experiments.cars N-CARS --json experiments/results/cars.json --picture "
        "docs/images/cars.png",
        {
            datasets.cars: "Accuracy on the test part by the time since the first event",
            datasets.cars_confidence: "What a level of confidence costs, looked at every 2 ms; *right of all*: windows "
            "that do not reach it are decided at their ends",
        },
        picture="cars",
    ),
    Section(
        "Without options",
        "`async-tnt train` with the sensor's size alone; each network read the test part once. "
        "N-MNIST: 8,000 "
        "recordings to learn from and 1,000 to test on, not the official split. POKER-DVS: 48 and "
        "20. HOTS' "
        "characters: 36 and 40.",
        "experiments.bare --nmnist N-MNIST --poker POKER-DVS --characters characters "
        "--json experiments/results/bare.json",
        {datasets.bare: "Test parts, mean and standard deviation over seeds"},
    ),
    Section(
        "Which default",
        DEFAULT,
        "experiments.recipes --cars N-CARS --nmnist N-MNIST --poker POKER-DVS --characters "
        "characters "
        "--json experiments/results/recipes.json",
        {datasets.recipes: "Held-out windows right at their ends / in the mean over ten moments"},
    ),
    Section(
        "Which input",
        INPUTS,
        "experiments.thesis_table --nmnist N-MNIST --mnist MNIST --rows comparison representations "
        "--into experiments/results/table.json",
        {datasets.representations: "Accuracy and costs, by input"},
    ),
    Section(
        "Early decisions",
        "The 1,000 test recordings of `digits`, a decision every 2.1 ms. Windows that do not reach "
        "a confidence count "
        "with the decision at their end, after 105 ms. Nothing was chosen by these numbers.",
        "async_tnt evaluate digits N-MNIST --json > experiments/results/early.json",
        {
            accuracy.early: "By time, and by confidence",
        },
    ),
    Section(
        "Where nothing is",
        "Windows with the times of the bundled recordings' events, which stand somewhere else, and "
        "other objects. "
        "Training showed `digits` noise, one polarity, hot pixels, patches and straight edges, by "
        "code of its own. "
        "When it had seen noise alone, the shares were .00, .46, .00, .72, .25, .84, .22, .48, "
        ".56, .77, .17.",
        "experiments.nothing --poker POKER-DVS/pips_train --characters characters --cars "
        "n-cars_train "
        "--json experiments/results/nothing.json",
        {accuracy.nothing: "Share of windows in which a class has .9 at their ends"},
    ),
    Section(
        "The model digits",
        RECIPE,
        "",
        {
            accuracy.digits_against_time: "Share of windows right by the time since the window's start, and of "
            "recordings by the mean of three windows",
            accuracy.digits_confusion: "Windows from 0",
            accuracy.digits_tried_motions: "Trainings with other motions; each continues the one that it names, 0 is "
            "the model that was bundled before. Accuracy in % on held-out recordings",
            accuracy.digits_tried: "Settings compared before that, six epochs each; differences below 0.5 are noise",
        },
    ),
    Section(
        "The thesis' table",
        THESIS,
        "experiments.thesis_table --nmnist N-MNIST --mnist MNIST --into "
        "experiments/results/table.json",
        {
            thesis.thesis_rows: "The thesis' own rows; in brackets its numbers, from the official split and simulated "
            f"motions of its own, which were probably like {THESIS_SET!r}",
            thesis.curves: "60,000 steps: held-out windows right / their loss",
            differences.thesis_sets: "On nine sets of 30 simulated motions; bold: better or worse than the Baseline",
            differences.effects: "What the gain depends on",
            thesis.comparison: "The comparison: 3,000 steps, t_max 2, five seeds",
            differences.differences: "Differences and their 95 % intervals; bold: holds among all of its question",
            differences.conclusions: "All that hold",
            thesis.against_time: "Unseen motions, by the time since a window's start",
        },
        picture="directions",
    ),
    Section(
        "Layers and flow",
        "Equivariance errors of `digits`' layers: how far the features of a digit with flow added "
        "are from those "
        "without, translated by whole cells of the layer; "
        "[drawn](../docs/theory.md#the-temporal-normalization-"
        "transform).",
        "experiments.figure_equivariance --json experiments/results/equivariance.json",
        {thesis.equivariance: "By input, layer and pixels per window"},
    ),
    Section(
        "Missing edges and polarity",
        "1,000 N-MNIST recordings; each saccade's events are moved back onto the MNIST image that "
        "was shown.",
        "experiments.edges --nmnist N-MNIST --mnist MNIST --json experiments/results/edges.json",
        {
            accuracy.edges: "Events for each unit of gradient, by the angle between gradient and motion",
            accuracy.polarity: "Correlation of two saccades' images over pixels",
        },
    ),
    Section(
        "Re-synthesized motions",
        MOTIONS,
        "experiments.thesis_table --nmnist N-MNIST --mnist MNIST --rows motions --into "
        "experiments/results/table.json",
        {
            thesis.resynthesis: "Accuracy",
            thesis.resynthesis_match: "How well the recorded motion is matched",
        },
    ),
    Section(
        "Few events, in motions that were not recorded",
        FEW,
        "experiments.unseen_motions --set saccades --json experiments/results/unseen_saccades.json",
        {
            accuracy.unseen_saccades: "N-MNIST's saccades with a fifth of their events",
            accuracy.unseen_whole: "All events of the first saccade of 8,000 recordings: `--set whole --seeds 3 --json "
            "experiments/results/unseen_whole.json`",
            accuracy.unseen_hands: "Hand motion: `--set hands --json experiments/results/unseen_hands.json`",
            accuracy.unseen_volumes: "The saccades by what is learned from: `--set volumes --seeds 1 --json "
            "experiments/results/unseen_volumes.json`. The default was set after this was seen; "
            "held-out windows in "
            "other motions are ordered alike: .897, .922, .826, .915, .879",
        },
    ),
    Section(
        "Paths that are found",
        "Right: within 45 degrees, of the median at full rate or of the swing. The constants of "
        "the rules were set by "
        "the rows of N-MNIST's training recordings and of noise; hand motion (2 to 3 pixels, 1.2 "
        "to 2.7 events each, "
        "`experiments/objects/hands.py`) set none. Paths only shift: of objects that turn by 16° or "
        "grow by 25 % in a "
        "swing (standard deviations) those found are right nearly as often, and more are refused.",
        "experiments.found_paths --nmnist N-MNIST --json experiments/results/found_paths.json",
        {accuracy.found_paths: "Windows with a path that is relied on"},
    ),
    Section(
        "Pictures alone",
        FROM_PICTURES,
        "experiments.from_pictures --nmnist N-MNIST --poker POKER-DVS --characters characters "
        "--made --fonts FONTS "
        "--seeds 5 --json experiments/results/from_pictures.json",
        {
            datasets.from_pictures: "Tested on real recordings, or on those of another renderer",
            datasets.moved_digits: "N-MNIST's networks on simulated test images, in motions and speeds of their own",
        },
    ),
    Section(
        "Pictures and few recordings",
        "How many real recordings of each class a classifier of N-MNIST needs, with MNIST's 60,000 "
        "training images and "
        "without: one network each, `async-tnt train FOLDER --sensor 34x34`, which reads 1,000 of "
        "Test once, as "
        "did networks of an earlier version that recorded each picture once (pictures alone .985). "
        "Differences below "
        ".005 may be chance.",
        "experiments.few_recordings --json experiments/results/few_recordings.json --picture "
        "docs/images/few_recordings.png",
        {datasets.few_recordings: "Windows and recordings right"},
        picture="few_recordings",
    ),
    Section(
        "Several objects on a large sensor",
        EVERYWHERE,
        "experiments.everywhere digits-everywhere MODEL ... --json "
        "experiments/results/everywhere.json",
        {
            datasets.everywhere: "Real digits in scenes",
            datasets.car_scenes: "Cars",
            streams.map_times: "From events to objects, `push` and `fire`, beside the whole map, after three digits, "
            "medians and 99th percentiles: `python -m experiments.map_times --json "
            "experiments/results/map_times.json`",
            streams.map_load: "A million events and 1,000 decisions a second on 320x240: processor seconds for "
            "each second of the stream, which must stay below 1",
            streams.map_machine: "Machine",
        },
    ),
    Section(
        "Two threads",
        "Two streams in two threads of one process: the time of one after the other, divided by "
        "that of both at once; "
        "quartiles lie up to .1 away.",
        "experiments.threads --json experiments/results/threads.json",
        {streams.threads: "How much faster", streams.threads_machine: "Machine"},
    ),
    Section(
        "What a machine sustains",
        "Streams in real time, in packets of a millisecond, through `KeepUp` with at most 50 ms, a "
        "minute each. Load: "
        "the rate, divided by the one that takes a core. Delays from the moment a packet was due "
        "to the end of its "
        "decisions.",
        "experiments.sustained --seconds 60 --json experiments/results/sustained.json",
        {streams.sustained: "Delays under load"},
    ),
    Section(
        "Simulated and real recordings",
        SIMULATED,
        "experiments.moving_mnist --mnist MNIST --out moving --nmnist N-MNIST",
    ),
    Section(
        "Network",
        "Two processes, UDP on loopback, datagrams of 100 events, 1300 bytes. Latency from just "
        "before `send`; the "
        "plain socket's time is the system's. Delays count from the time an event was due at the "
        "sender.",
        "experiments.network --json experiments/results/network.json",
        {
            streams.udp_machine: "Machine",
            streams.udp_latency: "Latency",
            streams.udp_load: "A million events a second for a minute, a decision every 5 ms",
        },
    ),
)


def page() -> str:
    """RESULTS.md."""
    parts = [
        "# All results",
        "Written by `python -m experiments.pages`, the tables from `results/*.json` and the record "
        "inside the bundled "
        "model (that of simulated and real recordings by hand); do not edit.\n[What they "
        "say](../docs/results.md), "
        "with the most important tables. Timings are medians on shared 2-core virtual machines.",
    ]
    for section in SECTIONS:
        parts.append(f"## {section.title}")
        if section.text:
            parts.append(section.text)
        if section.command:
            parts.append(f"```sh\npython -m {section.command}\n```")
        if section.picture:
            parts.append(f"![{section.title}](../docs/images/{section.picture}.png)")
        for table, caption in section.tables.items():
            parts += [f"**{caption}**", table()]
    return "\n\n".join(parts) + "\n"
