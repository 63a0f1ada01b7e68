"""What stands in RESULTS.md: the sections, how their tables were measured, and what each table shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from experiments import accuracy_tables as accuracy
from experiments import dataset_tables as datasets
from experiments import decision_tables as decisions
from experiments import stream_tables as streams
from experiments import thesis_tables as thesis

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


RECIPE = """\
Not the official N-MNIST test: training used the official training recordings 1-1,000 and 7,000 of the official *test*
recordings, the test 1,000 others of these, 100 per digit. The standard error is 0.2-0.3 %. The model: TNT about the
running centroid, t_max 4, nine bins of 105 ms on 34 x 34 pixels, 16 and 32 convolution channels, 64 hidden units,
137,738 weights.

It was trained in five steps, which `python -m experiments.digits` repeats in hours. The fourth also shows scattered
events, the fifth all kinds of nothing of `train`; half of its target is what the fourth model says. .27 of the weights
are the fourth model's, .73 the average over the fifth step; the probabilities are calibrated.

Data: 7,201 real and 20,000 simulated recordings of MNIST training images from 5,000 on; 799 real ones were held out.
Augmentation: the window's start moves by up to 5 ms, events by 1.5 px, rotation 10 degrees, scale and shear 10 %, up
to 30 % of events dropped, every fifth window (in the last two steps every second) cut at 15-105 ms; in these, every
fifth or 15 % of the windows show nothing. AdamW, decay 0.01, batches of 64, cosine rate from 0.002 (then .001, .001,
.0005, .001), label smoothing 0.05, seed 0.

Trainings were compared on held-out recordings, and on the bundled samples, which are no test therefore: the last one
mixes two by the largest share with which all samples are right. 7, 8, 9, 11 and one more have read the test; none
chose."""

CARS = """\
N-CARS (A. Sironi et al. 2018, [arXiv:1803.07913](https://arxiv.org/abs/1803.07913)): 15,422 recordings to train on (one
is a duplicate) and 8,607 to test on. Each row is `async-tnt train n-cars_train --sensor 120x100` with its options. The
recipe was found on the last fifth of the training part; of the first row the last twentieth is held out, on which the
networks have .966 to .976. When all networks of a row were trained, each read the test part once, the first two also
together, by the mean of their probabilities. Earlier versions of this project had seen it, with other recipes (.81 to
.93). Most training recordings are right by the width and height of their crops alone, which a table of the training
part tells, smoothed over two pixels; so are most test recordings: a shortcut that every network on these crops may
take. For each row and each input, 11,679 decisions of the first network, one after every event, were compared with the
network computed in full: all bits are equal. The rows of the comparison of inputs are of an earlier version."""

DEFAULT = """\
No test part was read: held out are the last recordings of each class, of HOTS' characters the end of each recording,
and of `sessions`, which is made, a second session with other thresholds, noise, places and sizes. Where objects move
far within a window, counts lose accuracy to time bins; on N-CARS, bins to counts. Events of one polarity of an active
pixel tell the two apart: N-CARS has 1.7 of them, `sessions` 3.0, N-MNIST 3.2, POKER-DVS 4.1, the characters 11. From
2.25 on the default is five bins; that value was set after these five. N-CARS and N-MNIST: ten epochs; without
`--mirror`."""

INPUTS = """\
On each data set every input gets the same network and number of steps, five seeds. N-MNIST: trained on all three
saccades or on the first, tested on all three or in 30 simulated motions ("sim"); 3,000 steps, t_max 2, translations;
volumes are signed, images split by polarity, `line` has its flow removed, HATS 8x8 cells. N-CARS: accuracy at the time
given; network `residual`, six epochs, t_max 3, all split by polarity, on a grid of 60x50, HATS with 12x10 cells.
Costs, on N-CARS: an event in the volume, and a decision after every event."""

THESIS = """\
Columns: trained on / tested on. *all*: all three saccades; *1*: the first; *others*: the second and third; *train*:
all three of the training digits; *sim*: 30 simulated motions. The rows were listed before the first was trained; they
share network, optimizer and number of steps (3,000), with events thinned by up to 30 %. Mean ± standard deviation over
five seeds. Data as for `digits`; of simulated sets only images are tested that no training recording shows. No number
of the second or third saccade or of the simulated motions chose a row, a setting or a number of steps of this table;
in other motions the numbers of some earlier settings had been seen (t_max 2, 4 and 8, a scale for each bin, rotations,
scalings and shears; one or two seeds: .379 to .473 in 1/all). t_max 2 has the lowest held-out loss of 2, 3, 4 and 8
for each of `center` (.090), `running` (.086) and `line` (.097), after 2,260 steps on the first saccade with rotations,
scalings and shears. `results/table.json` has all settings, seeds and intervals."""

MOTIONS = """\
All networks are trained for 8,000 steps; the motions of a row are made once, for all seeds. *confounded*: each digit
is seen in one saccade only, 0-3 in the first, 4-6 in the second and 7-9 in the third, so that the motion tells more
than the shape; "raw" is the control. Earlier versions, with at most 8 variations of a window, were tested on saccades
2 and 3 and on the simulated set. The image's prior and the random places were changed once after that; the number of
variations was chosen by accuracy on held-out recordings in re-synthesized motions. No result led to these changes.
Untransformed, trained on 1 and confounded are of the present code, which finds paths where events are few; the other
re-synthesized columns are of the rules and images before it. With those, raw had .982 in 1/all and in 1/sim, and .981
confounded: total variation in the place of the present penalty, and half of the motions without turns, did not bring
the difference back; on the 21,603 windows of 1/train there is none (.990 before, too)."""

FEW = """\
Trained in one direction, or in all; means of seeds (lowest to highest). Saccades: 4,800 recordings of N-MNIST's
Train show the first one, or all three in turn; the 1,000 of Test show each. Hands: eight dark objects, 1,280 recordings
that move to the right, or in eight directions; 320 in each test. The signs were chosen by the first and last row."""

SIMULATED = """\
200 recordings of N-MNIST's test set, simulations of the same MNIST images under N-MNIST's own motion, and
N-MOVING-MNIST's `constant` and `bell` motions; the last with `--motions bell`. Constant motion spreads the same events
evenly over the window, hence the longer intervals. With 8 px a digit's outermost image ring leaves the sensor; it is
empty in 98.9 % of the images.

| mean of a saccade | N-MNIST | simulated | constant | bell |
|---|---|---|---|---|
| events | 1387 | 1407 | 1389 | 1264 |
| active pixels [%] | 26.3 | 26.1 | 25.5 | 24.7 |
| events per active pixel | 4.57 | 4.67 | 4.72 | 4.43 |
| same-pixel interval, 5 % quantile [ms] | 2.13 | 2.28 | 3.25 | 2.34 |
| same-pixel interval, median [ms] | 4.52 | 4.64 | 7.22 | 5.41 |
| ON events [%] | 49.7 | 49.1 | 48.5 | 48.6 |
| ON minus OFF centroid along the motion [px] | -3.92 | -3.65 | -3.88 | -3.81 |
| ON minus OFF centroid across the motion [px] | -0.17 | -0.25 | -0.01 | -0.01 |"""

SECTIONS = (
    Section(
        "Decisions",
        "What is compared runs in one process, on one thread each, warm, taking turns, and must first give the same "
        "logits within 1e-4. *In blocks*: 50 decisions in a row, so that each network has the caches to itself. *Call "
        "by call*: the networks alternate at every decision. Ratios are taken pair by pair. Latency is wall-clock "
        "time, throughput processor time. OpenVINO uses float32 and the hint LATENCY.",
        "experiments.decisions --json experiments/results/decisions.json --picture docs/images/decisions.png",
        {
            decisions.decisions_machine: "Machine",
            decisions.network_in_blocks: "The network alone, in blocks: microseconds from a finished volume to its "
            "logits, 99th percentile, ratio to the incremental one; random volumes change everywhere",
            decisions.network_call_by_call: "The network alone, call by call",
            decisions.end_to_end_in_blocks: "From a packet to the decision, in blocks",
            decisions.end_to_end_call_by_call: "From a packet to the decision, call by call",
            decisions.every_event: "A decision after every event, recordings in packets of 1,000 events",
            decisions.singles: "One event at a time with `push_one`; the last row's tail is the machine's",
            decisions.touched: "What new events change, means over a thousand moments",
        },
    ),
    Section(
        "Starts",
        "A fresh process, to its first decision. A `Processor` compiles in its own process, commands compile in two.",
        "experiments.starts --json experiments/results/starts.json",
        {decisions.starts_machine: "Machine", decisions.starts: "Seconds, medians of five"},
    ),
    Section(
        "Four networks",
        "Random weights, on the bundled recordings, whose pixels are mapped onto each grid: that of the thesis; "
        "`conv4`, four convolutions with batch norm and max pooling; `residual`; and one for gestures, a 2x2 stem of "
        "stride 2 and four 3x3 convolutions with average pooling.",
        "experiments.incremental --json experiments/results/incremental.json --picture docs/images/incremental.png",
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
        "Landmark `running`, 8 cells, transform included. eventcv and tonic fill 2 cells of whole pixels; only ours "
        "and `scatter_add_` transform. The peers build a volume from one packet; ours adds the packet to the window so "
        "far. Volumes that should be equal are checked to be equal. On the processor named under Network.",
        "experiments.peers --json experiments/results/peers.json",
        {
            streams.splat: "Beside the peers",
            streams.volumes: "By the size of a packet (`experiments.volumes`)",
        },
    ),
    Section(
        "Memory",
        "",
        "experiments.memory > experiments/results/memory.json",
        {streams.memory: "Growth of a long stream"},
    ),
    Section(
        "Cars",
        CARS,
        "experiments.cars N-CARS --json experiments/results/cars.json --picture docs/images/cars.png",
        {
            datasets.cars: "Accuracy on the test part by the time since the first event",
            datasets.cars_confidence: "What a level of confidence costs, looked at every 2 ms; *right of all*: windows "
            "that do not reach it are decided at their ends",
        },
        picture="cars",
    ),
    Section(
        "Without options",
        "`async-tnt train` with the sensor's size alone; each network read the test part once. N-MNIST: 8,000 "
        "recordings to learn from and 1,000 to test on, not the official split. POKER-DVS: 48 and 20. HOTS' "
        "characters: 36 and 40.",
        "experiments.bare --nmnist N-MNIST --poker POKER-DVS --characters characters "
        "--json experiments/results/bare.json",
        {datasets.bare: "Test parts, mean and standard deviation over seeds"},
    ),
    Section(
        "Which default",
        DEFAULT,
        "experiments.recipes --cars N-CARS --nmnist N-MNIST --poker POKER-DVS --characters characters "
        "--json experiments/results/recipes.json",
        {datasets.recipes: "Held-out windows right at their ends / in the mean over ten moments"},
    ),
    Section(
        "Which input",
        INPUTS,
        "experiments.thesis_table --nmnist N-MNIST --simulated moving-mnist --rows comparison representations",
        {datasets.representations: "Accuracy and costs, by input"},
    ),
    Section(
        "Early decisions",
        "The 1,000 test recordings of `digits`, each window's first decision by a trigger; windows without one count "
        "with the decision at their end, after 105 ms. Nothing was chosen by these numbers. *Noise*: nothing is there, "
        "with as many events as real windows have. Training showed `digits` *uniform* noise; *few* are a fifteenth of "
        "the events, *flicker* is everywhere at once every 10 ms, *pairs* are two neighbouring pixels at a time, "
        "*one polarity* is all ON, and was shown as well.",
        "experiments.early --json experiments/results/early.json --picture docs/images/early.png",
        {
            accuracy.early: "By trigger",
            accuracy.of_nothing: "Before any event",
            accuracy.soon: "Decisions from few events",
            accuracy.noise: "In how many windows of noise a class is decided",
        },
        picture="early",
    ),
    Section(
        "Where nothing is",
        "Windows with the times of the bundled recordings' events, which stand somewhere else, and other objects. "
        "Training showed `digits` noise, one polarity, hot pixels, patches and straight edges, by code of its own. "
        "When it had seen noise alone, the shares were .00, .46, .00, .72, .25, .84, .22, .48, .56, .77, .17.",
        "experiments.nothing --poker POKER-DVS/pips_train --characters characters --cars n-cars_train "
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
        "experiments.thesis_table --nmnist N-MNIST --simulated moving-mnist",
        {
            thesis.comparison: "The comparison",
            thesis.conclusions: "Differences of pairs that were set beforehand, with 95 % intervals of their mean",
            thesis.simulated_sets: "Other simulated motions, after training on all three saccades; bold: better or "
            "worse than raw. Of the last set, 3,000 images were tested, of the others 611",
            thesis.learning_curve: "Fewer recordings",
            thesis.thesis_rows: "The thesis' own rows: 60,000 steps, t_max 8, nothing thinned, one seed; in brackets "
            "the thesis' numbers, from the official split and simulated motions of its own",
        },
        picture="directions",
    ),
    Section(
        "Missing edges and polarity",
        "1,000 N-MNIST recordings; each saccade's events are moved back onto the MNIST image that was shown.",
        "experiments.edges --nmnist N-MNIST --mnist MNIST --json experiments/results/edges.json",
        {
            accuracy.edges: "Events for each unit of gradient, by the angle between gradient and motion",
            accuracy.polarity: "Correlation of two saccades' images over pixels",
        },
    ),
    Section(
        "Re-synthesized motions",
        MOTIONS,
        "experiments.thesis_table --nmnist N-MNIST --simulated moving-mnist --rows motions",
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
            accuracy.unseen_saccades: "N-MNIST's saccades with a fifth of their events, five seeds",
            accuracy.unseen_hands: "Hand motion, five seeds: `--set hands --json .../unseen_hands.json`",
        },
    ),
    Section(
        "Paths that are found",
        "Right: within 45 degrees, of the median at full rate or of the swing. The constants of the rules were set by "
        "the rows of N-MNIST's training recordings and of noise; hand motion (2 to 3 pixels, 1.2 to 2.7 events each, "
        "`experiments/made_hands.py`) set none.",
        "experiments.found_paths --nmnist N-MNIST --json experiments/results/found_paths.json",
        {accuracy.found_paths: "Windows with a path that is relied on"},
    ),
    Section(
        "Simulated and real recordings",
        SIMULATED,
        "experiments.moving_mnist --mnist MNIST --out moving --nmnist N-MNIST",
    ),
    Section(
        "Network",
        "Two processes, UDP on loopback, datagrams of 100 events, 1300 bytes. Latency from just before `send`; the "
        "plain socket's time is the system's. Delays count from the time an event was due at the sender. Received = "
        "pushed + skipped.",
        "experiments.network --seconds 60 > experiments/results/network.json",
        {
            streams.udp_machine: "Machine",
            streams.udp_latency: "Latency",
            streams.udp_load: "A million events a second for a minute, a decision every 5 ms",
            streams.udp_overload: "Ten times that, through `BackgroundReader(source, latest=True, max_events=50_000)`",
        },
    ),
)


def page() -> str:
    """RESULTS.md."""
    parts = [
        "# All results",
        "Written by `python -m experiments.pages` from `results/*.json` and from the record inside the bundled model; "
        "do not edit.\n[What they say](../docs/results.md), with the most important tables. Timings are medians on "
        "shared 2-core virtual machines.",
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
