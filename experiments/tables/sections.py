"""The sections of RESULTS.md: how tables were measured, and what each table shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from experiments.tables import (
    accuracy,
    datasets,
    decisions,
    differences,
    flow,
    published,
    scales,
    sliding,
    sliding_curves,
    spiking,
    streams,
    teaching,
    thesis,
)
from experiments.tables.runs import about_runs
from experiments.tables.texts import (
    BOX_COST,
    CARS,
    DECISIONS,
    DEFAULT,
    EARLY,
    EDGES,
    EVERYWHERE,
    FEW,
    FEW_PICTURES,
    FLOW,
    FROM_PICTURES,
    INPUTS,
    INTRODUCTION,
    LAYER_TIMES,
    LAYERS,
    MOTIONS,
    NETWORKS,
    NOTHING,
    OBJECT_SCALES,
    OTHER_PAGES,
    PATHS,
    PIXEL_OUTPUTS,
    RECIPE,
    SIMULATED,
    SLIDING,
    SLIDING_TRAINING,
    SPIKING,
    STARTS,
    SUSTAINED,
    TEACHING,
    THESIS,
    THREADS,
    UDP,
    VOLUMES,
    WITHOUT_OPTIONS,
    ZOO,
)
from experiments.thesis.rows import THESIS_SET

Table = Callable[[], str]


@dataclass(frozen=True)
class Section:
    """A section of RESULTS.md.

    Parameters
    ----------
    title : heading of the section.
    text : how the numbers were measured, and what limits them; Markdown.
    command : commands that measure them again, a line each and without `python -m`, or a function
        that makes them of the results; "" if there is none.
    picture : name of a picture in docs/images; "" if there is none.
    tables : function that makes a table -> what the table shows.
    results : names of the files or folders in experiments/results that the tables are made of.
    """

    title: str
    text: str = ""
    command: str | Callable[[], str] = ""
    picture: str = ""
    tables: dict[Table, str] = field(default_factory=dict)
    results: tuple[str, ...] = ()


SECTIONS = (
    Section(
        title="Decisions",
        text=DECISIONS,
        command=(
            "experiments.decisions --json experiments/results/decisions.json --picture "
            "docs/images/decisions.png"
        ),
        tables={
            decisions.decisions_machine: "Machine",
            decisions.network_in_blocks: (
                "The network alone, in blocks: microseconds from a finished volume to its logits, "
                "99th percentile, ratio to the incremental one"
            ),
            decisions.network_call_by_call: "The network alone, call by call",
            decisions.end_to_end_in_blocks: "From a packet to the decision, in blocks",
            decisions.end_to_end_call_by_call: "From a packet to the decision, call by call",
            decisions.every_event: (
                "A decision after every event, recordings in packets of 1,000 events"
            ),
        },
        results=("decisions",),
    ),
    Section(
        title="Starts",
        text=STARTS,
        command="experiments.starts --json experiments/results/starts.json",
        tables={
            decisions.starts_machine: "Machine",
            decisions.starts: "Seconds, medians of five",
        },
        results=("starts",),
    ),
    Section(
        title="Four networks",
        text=NETWORKS,
        command=(
            "experiments.incremental --json experiments/results/incremental.json --picture "
            "docs/images/incremental.png"
        ),
        picture="incremental",
        tables={
            decisions.incremental_machine: "Machine",
            decisions.incremental_times: (
                "Microseconds from a finished volume to its logits, in blocks, 99th percentile, "
                "ratio to the incremental one"
            ),
            decisions.incremental_work: "Multiplications, memory, and a decision after every event",
        },
        results=("incremental",),
    ),
    Section(
        title="Where the time goes",
        text=LAYER_TIMES,
        command="experiments.layer_times --json experiments/results/layer_times.json",
        tables={
            decisions.layer_machine: "Machine",
            decisions.layer_peak: "The core",
            decisions.layer_times: (
                "Microseconds / thousands of multiplications / share of the core's peak"
            ),
        },
        results=("layer_times",),
    ),
    Section(
        title="Published networks",
        text=ZOO,
        command="experiments.zoo --json experiments/results/zoo.json",
        tables={
            published.zoo_counts: "In numbers",
            published.zoo_accepted: "Accepted from torch",
            published.zoo_refused: "Refused, and why",
        },
        results=("zoo",),
    ),
    Section(
        title="Flow at every pixel",
        text=PIXEL_OUTPUTS,
        command="experiments.pixel_outputs --json experiments/results/pixel_outputs.json",
        tables={published.pixel_outputs: "By the size of the sensor"},
        results=("pixel_outputs",),
    ),
    Section(
        title="Events into a volume",
        text=VOLUMES,
        command="experiments.volumes --json experiments/results/bench.json",
        tables={
            streams.volumes: "By the size of a packet",
        },
        results=("bench",),
    ),
    Section(
        title="Memory",
        command="experiments.memory --json experiments/results/memory.json",
        tables={
            streams.memory: "Growth of a long stream",
        },
        results=("memory",),
    ),
    Section(
        title="Cars",
        text=CARS,
        command=datasets.cars_command,
        picture="cars",
        tables={
            datasets.cars: "Accuracy on the test part by the time since the first event",
            datasets.cars_work: (
                "Work after an event: published, and of the first network of each row"
            ),
            datasets.cars_confidence: (
                "What a level of confidence costs, looked at every 2 ms, means over the networks "
                "of the first row; *right of all*: windows that do not reach it are decided at "
                "their ends"
            ),
        },
        results=("cars",),
    ),
    Section(
        title="Without options",
        text=WITHOUT_OPTIONS,
        command=datasets.bare_command,
        tables={
            datasets.bare: "Test parts, mean and standard deviation over networks",
        },
        results=("bare",),
    ),
    Section(
        title="Which default",
        text=DEFAULT,
        command=(
            "experiments.recipes --cars N-CARS --nmnist N-MNIST --poker POKER-DVS --characters "
            "characters --json experiments/results/recipes.json\n"
            'experiments.recipes --sets sessions --candidates "3 bins" "time surface" "counts and '
            'times" --json experiments/results/recipes.json'
        ),
        tables={
            datasets.recipes: (
                "Held-out windows right at their ends / in the mean over the moments, one network "
                "in each cell"
            ),
        },
        results=("recipes",),
    ),
    Section(
        title="Which input",
        text=INPUTS,
        command=datasets.inputs_commands,
        tables={
            datasets.representations: (
                "Accuracy and costs, by input; mean ± standard deviation over networks"
            ),
        },
        results=("thesis", "cars"),
    ),
    Section(
        title="Early decisions",
        text=EARLY,
        command="experiments.early --nmnist N-MNIST --json experiments/results/early.json",
        tables={
            accuracy.early: "By time, and by confidence",
        },
        results=("early",),
    ),
    Section(
        title="Where nothing is",
        text=NOTHING,
        command=(
            "experiments.nothing --poker POKER-DVS/pips_train --characters characters --cars "
            "n-cars_train --json experiments/results/nothing.json"
        ),
        tables={
            accuracy.nothing: "Share of windows in which a class has .9 at their ends",
        },
        results=("nothing",),
    ),
    Section(
        title="The model digits",
        text=RECIPE,
        tables={
            accuracy.digits_against_time: (
                "Share of windows right by the time since the window's start, and of recordings "
                "by the mean of three windows"
            ),
            accuracy.digits_confusion: "Windows from 0",
            accuracy.digits_tried_motions: (
                "Trainings with other motions; each continues the one that it names, 0 is the "
                "model that was bundled before. Accuracy in % on held-out recordings"
            ),
            accuracy.digits_tried: (
                "Settings compared before that, six epochs each; differences below 0.5 are noise"
            ),
        },
    ),
    Section(
        title="The thesis' table",
        text=THESIS,
        command=thesis.thesis_command,
        picture="directions",
        tables={
            thesis.thesis_rows: (
                "The thesis' own rows; in brackets its numbers, from the official split and "
                f"simulated motions of its own, which were probably like {THESIS_SET!r}"
            ),
            differences.thesis_sets: (
                "On nine sets of 30 simulated motions; bold: better or worse than the Baseline"
            ),
            differences.effects: "What the gain depends on",
            thesis.comparison: "The comparison: 3,000 steps, t_max 2",
            thesis.t_max: (
                "Other values of t_max: TNT about the running centroid, held-out digits of the "
                "first saccade"
            ),
            thesis.foreign: "The motions of *sim*, seen by the pixels of v2e",
            differences.differences: (
                "Differences and their 95 % intervals; bold: holds among all of its question"
            ),
            differences.conclusions: "All that hold",
            thesis.against_time: "Unseen motions, by the time since a window's start",
        },
        results=("thesis",),
    ),
    Section(
        title="Layers and flow",
        text=LAYERS,
        command="experiments.figure_equivariance --json experiments/results/equivariance.json",
        tables={
            thesis.equivariance: "By input, layer and pixels per window",
        },
        results=("equivariance",),
    ),
    Section(
        title="Missing edges and polarity",
        text=EDGES,
        command=(
            "experiments.edges --nmnist N-MNIST --mnist MNIST --json experiments/results/edges.json"
        ),
        tables={
            accuracy.edges: (
                "Events for each unit of gradient, by the angle between gradient and motion"
            ),
            accuracy.polarity: "Correlation of two saccades' images over pixels",
        },
        results=("edges",),
    ),
    Section(
        title="Re-synthesized motions",
        text=MOTIONS,
        command=thesis.motions_command,
        tables={
            thesis.resynthesis: "Accuracy",
            thesis.controls: "Beside the best of the cheap ways",
            thesis.resynthesis_match: "How well the recorded motion is matched",
        },
        results=("thesis",),
    ),
    Section(
        title="Few events, in motions that were not recorded",
        text=FEW,
        command=accuracy.unseen_commands,
        tables={
            accuracy.unseen_saccades: (
                "N-MNIST's saccades with a fifth of their events: `--set saccades`"
            ),
            accuracy.unseen_whole: (
                "All events of the first saccade of 8,000 recordings: `--set whole`"
            ),
            accuracy.unseen_hands: "Hand motion: `--set hands`",
            accuracy.unseen_volumes: (
                "The saccades by what is learned from, re-synthesized: `--set volumes`. The "
                "default was set after this was seen"
            ),
        },
        results=("unseen_saccades", "unseen_whole", "unseen_hands", "unseen_volumes"),
    ),
    Section(
        title="Paths that are found",
        text=PATHS,
        command=(
            "experiments.found_paths --nmnist N-MNIST --json experiments/results/found_paths.json"
        ),
        tables={
            accuracy.found_paths: "Windows with a path that is relied on",
        },
        results=("found_paths",),
    ),
    Section(
        title="Pictures alone",
        text=FROM_PICTURES,
        command=(
            "experiments.from_pictures --nmnist N-MNIST --seeds 5 --json "
            "experiments/results/from_pictures.json\n"
            "experiments.from_pictures --poker POKER-DVS --fonts FONTS --seeds 5 --json "
            "experiments/results/from_pictures.json\n"
            "experiments.from_pictures --characters characters --fonts FONTS-UP-TO-1-MB --seeds 5 "
            "--json experiments/results/from_pictures.json\n"
            "experiments.from_pictures --made --seeds 5 --json "
            "experiments/results/from_pictures.json"
        ),
        tables={
            datasets.from_pictures: "Tested on real recordings, or on those of another renderer",
            datasets.moved_digits: (
                "N-MNIST's networks on simulated test images, in motions and speeds of their own; "
                "means over the networks"
            ),
        },
        results=("from_pictures",),
    ),
    Section(
        title="Pictures and few recordings",
        text=FEW_PICTURES,
        command=(
            "experiments.few_recordings --json experiments/results/few_recordings.json --picture "
            "docs/images/few_recordings.png"
        ),
        picture="few_recordings",
        tables={
            datasets.few_recordings: "Windows and recordings right, one network in each cell",
        },
        results=("few_recordings",),
    ),
    Section(
        title="A class from a few recordings",
        text=TEACHING,
        command=(
            "experiments.teaching --json experiments/results/teaching.json\n"
            "experiments.teaching --digits 4 --again --recordings 10 --json "
            "experiments/results/teaching.json\n"
            "experiments.teaching --digits 4,6 --fine --recordings 10 --json "
            "experiments/results/teaching.json\n"
            "experiments.teaching --digits 4,6 --settings --json "
            "experiments/results/teaching.json\n"
            "experiments.teaching --poker POKER-DVS --characters characters --json "
            "experiments/results/teaching.json"
        ),
        tables={
            teaching.teaching: (
                "New class / old classes / mean of ten; means over digits and five draws"
            ),
            teaching.teaching_others: (
                "The same on other data sets: classes left out in turn, new class / old classes / "
                "mean of all"
            ),
            teaching.teaching_by_digit: "Windows by the digit that was left out",
            teaching.teaching_costs: "What a taught class takes of others, and how sure it is",
            teaching.teaching_settings: (
                "Other settings, on recordings of Train that were held out; 4 and 6 left out, "
                "windows of the new class / of old classes"
            ),
        },
        results=("teaching",),
    ),
    Section(
        title="Several objects on a large sensor",
        text=EVERYWHERE,
        command=(
            "experiments.everywhere digits-everywhere --json experiments/results/everywhere.json"
        ),
        tables={
            datasets.everywhere: "Real digits in scenes",
            datasets.box_scenes: (
                "Real digits in scenes, by a model with boxes: `python -m experiments.everywhere "
                "boxes0.safetensors --json experiments/results/box_scenes.json`"
            ),
            streams.map_times: (
                "From events to objects, `push` and `fire`, beside the whole map, after three "
                "digits, medians and 99th percentiles: `python -m experiments.map_times --json "
                "experiments/results/map_times.json`"
            ),
            streams.map_load: (
                "A million events and 1,000 decisions a second on 320x240: processor seconds for "
                "each second of the stream, which must stay below 1"
            ),
            streams.map_machine: "Machine",
        },
        results=("everywhere", "box_scenes", "map_times"),
    ),
    Section(
        title="Objects of many sizes",
        text=OBJECT_SCALES,
        command=(
            "experiments.object_scales --out FOLDER --seeds 5 --json "
            "experiments/results/object_scales_tuning.json\n"
            "experiments.object_scales --out FOLDER --seeds 5 --final --json "
            "experiments/results/object_scales.json"
        ),
        tables={
            scales.object_scales: "Boxes in made scenes, the final set",
            scales.object_kinds: "F1 by kind at the end of the scenes",
            scales.object_mistakes: (
                "Which objects have a box at the end of the scenes, by size, of all networks; the "
                "overlap of both boxes is .5 or more"
            ),
            scales.object_mistaken: (
                "What is taken for what most often, 240x180; each network names the six pairs that "
                "it mistakes most often"
            ),
            scales.object_networks: (
                "Which network, in scenes of the tuning seed after 100 ms: `python -m "
                "experiments.object_scales --out FOLDER`, by the code of the commit and with the "
                "options of the row"
            ),
            scales.object_curve: (
                "The learning curve of the first network in 30 scenes of the tuning seed, on "
                "240x180 after 100 ms"
            ),
            scales.object_cost: (
                "A decision after one event, with boxes and with points, in one run. The scenes "
                "show three moving digits of N-MNIST, none of the network's kinds, so it finds few "
                "objects: `python -m experiments.box_cost MODEL --json "
                "experiments/results/box_cost_scales.json`"
            ),
        },
        results=(
            "object_scales",
            "object_scales_tuning",
            "object_scales_map",
            "object_scales_a_tenth",
            "object_scales_equal_weights",
            "object_scales_two_levels",
            "box_cost_scales",
        ),
    ),
    Section(
        title="Optical flow",
        text=FLOW,
        command="experiments.flow --json experiments/results/flow.json",
        tables={
            flow.flow_errors: (
                "Endpoint errors, mean and standard deviation over sequences; in brackets other "
                "networks' means; and in how many sequences the first network with overlapping "
                "windows is better"
            ),
            flow.flow_by_age: (
                "Endpoint errors by the age of a window that does not overlap, scenes as trained"
            ),
            flow.flow_along: "Where a plane is found, and along its normal flow",
            flow.flow_planes: "The settings of the plane fits",
            flow.flow_times: "From an event to the flow on 346x260",
            flow.flow_machine: "Machine",
        },
        results=("flow",),
    ),
    Section(
        title="Boxes beside points",
        text=BOX_COST,
        command="experiments.box_cost --json experiments/results/box_cost.json",
        tables={
            decisions.box_cost: "A decision after one event",
        },
        results=("box_cost",),
    ),
    Section(
        title="Windows that slide",
        text=SLIDING,
        command="experiments.sliding --json experiments/results/sliding.json",
        tables={
            sliding.sliding_events: (
                "An event into an image of counts or into bins, in packets of 1,300"
            ),
            sliding.sliding_decisions: "A decision after every event, RoShamBo's network",
            sliding.sliding_machine: "Machine",
        },
        results=("sliding",),
    ),
    Section(
        title="Training on windows that slide",
        text=SLIDING_TRAINING,
        command=(
            "experiments.sliding_training --nmnist N-MNIST --seeds 2 --json "
            "experiments/results/sliding_training.json\n"
            "experiments.sliding_training --cars N-CARS --seeds 1 --json "
            "experiments/results/sliding_training.json --picture docs/images/sliding.png"
        ),
        picture="sliding",
        tables={
            sliding_curves.sliding_training: (
                "Accuracy against the time since the first event, means over the networks"
            ),
        },
        results=("sliding_training",),
    ),
    Section(
        title="Spiking networks",
        text=SPIKING,
        command=(
            "experiments.spiking --json experiments/results/spiking.json --picture "
            "docs/images/spiking_bins.png"
        ),
        picture="spiking_bins",
        tables={
            spiking.spiking_accuracy: "Accuracy on N-MNIST",
            spiking.spiking_agreement: (
                "Spike for spike beside simulators, one event in each time step"
            ),
            spiking.spiking_bins: "Accuracy of sinabs by the width of a time step",
            spiking.spiking_work: "Work of an event, by layer",
            spiking.spiking_times: (
                "Processor time of an event or of a time step with one event, and of a recording"
            ),
            spiking.spiking_machine: "Machine",
            spiking.spiking_conversion: (
                "Accuracy of the network of ReLUs, and of spiking networks made of it"
            ),
            spiking.spiking_first_kernel: "An event beside the first plain kernel, by turns",
        },
        results=("spiking", "spiking_first_kernel"),
    ),
    Section(
        title="Two threads",
        text=THREADS,
        command="experiments.threads --json experiments/results/threads.json",
        tables={
            streams.threads: "How much faster",
            streams.threads_machine: "Machine",
        },
        results=("threads",),
    ),
    Section(
        title="What a machine sustains",
        text=SUSTAINED,
        command="experiments.sustained --json experiments/results/sustained.json",
        tables={
            streams.sustained: "Delays under load",
        },
        results=("sustained",),
    ),
    Section(
        title="Simulated and real recordings",
        text=SIMULATED,
        command=(
            "experiments.moving_mnist --mnist MNIST --out moving --digits 1000 --nmnist N-MNIST "
            "--result experiments/results/simulated.json"
        ),
        tables={
            datasets.simulated: "Means of a saccade",
        },
        results=("simulated",),
    ),
    Section(
        title="Network",
        text=UDP,
        command="experiments.network --json experiments/results/network.json",
        tables={
            streams.udp_machine: "Machine",
            streams.udp_latency: "Latency",
            streams.udp_load: "A million events a second for a minute, a decision every 5 ms",
        },
        results=("network",),
    ),
    Section(
        title="Results on other pages",
        text=OTHER_PAGES,
        results=("official_at_hand", "published_weights", "fit_pixels", "same_bits"),
    ),
)
"""The sections of RESULTS.md, in order."""


def page() -> str:
    """The text of RESULTS.md."""
    parts = ["# All results", INTRODUCTION]
    for section in SECTIONS:
        parts.append(f"## {section.title}")
        if section.text:
            parts.append(section.text)
        command = section.command if isinstance(section.command, str) else section.command()
        if command:
            lines = "\n".join(f"python -m {line}" for line in command.splitlines())
            parts.append(f"```sh\n{lines}\n```")
        if section.picture:
            parts.append(f"![{section.title}](../docs/images/{section.picture}.png)")
        for table, caption in section.tables.items():
            text = table()
            if text:
                parts += [f"**{caption}**", text]
        if section.results:
            parts += ["**Runs**", about_runs(section.results)]
    return "\n\n".join(parts) + "\n"
