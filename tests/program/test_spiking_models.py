"""What the commands do with a spiking model, and with NIR graphs."""

import json

import numpy as np
import pytest
from networks.random_spiking import random_spiking_model

from async_tnt import Processor, TNTConfig, load_model, open_recording
from async_tnt.networks import to_nir
from async_tnt.networks.models.spiking_volume import SpikingVolume
from async_tnt.sources import sample_recordings

CONFIG = TNTConfig(sensor=(34, 34), grid=(34, 34), representation="count", window_us=200_000)
MODEL = random_spiking_model(9, CONFIG)
RAW = random_spiking_model(11, CONFIG, raw=True)
SAMPLE = sample_recordings()[3]


@pytest.fixture
def model(tmp_path):
    return MODEL.save(tmp_path / "spiking.safetensors")


def test_run_prints_what_a_processor_decides(program, model):
    code, text, error = program("run", "3", "--model", model, "--json", "--every-us", "50000")
    values = [json.loads(line) for line in text.splitlines()]
    processor = Processor(MODEL, every_us=50_000)
    decisions = processor.push(open_recording(SAMPLE).read()) + processor.finish()
    assert code == 0 and not error
    assert [value["label"] for value in values] == [d.label for d in decisions]
    assert [value["events"] for value in values] == [d.events for d in decisions]


def test_run_prints_the_range_of_raw_outputs(program, tmp_path):
    path = RAW.save(tmp_path / "raw.safetensors")
    code, text, _ = program("run", "3", "--model", path)
    assert code == 0 and "  spikes 0 to " in text and "  first_spike_us -1 to " in text


def test_info_tells_neurons(program, model):
    code, text, _ = program("info", model)
    assert code == 0 and f"{MODEL.n_neurons:,} neurons" in text and "spiking: " in text
    _, text, _ = program("info", model, "--json")
    report = json.loads(text)
    assert report["neurons"] == MODEL.n_neurons and "multiplications" not in report


def test_bench_counts_spikes_and_additions(program, model):
    code, text, _ = program("bench", "--model", model, "--json")
    report = json.loads(text)
    volume = SpikingVolume(MODEL)
    spikes = dict.fromkeys(volume.network.layers, 0)
    additions = dict.fromkeys(volume.network.layers, 0)
    n_events = 0
    for path in sample_recordings().values():
        events = open_recording(path).read()
        volume.open(int(events["t"][0]))
        volume.update(events[events["t"] < events["t"][0] + CONFIG.window_us])
        n_events += volume.n_events
        for layer in spikes:
            spikes[layer] += volume.spikes(layer)
            additions[layer] += volume.additions(layer)
    assert code == 0 and "us_a_whole_pass" not in report and "multiplications" not in report
    assert report["spikes_an_event"] == {name: n / n_events for name, n in spikes.items()}
    assert report["additions_an_event"] == {name: n / n_events for name, n in additions.items()}
    assert len(spikes) > 1 and report["decisions_a_second"]["median"] > 0
    code, text, _ = program("bench", "--model", model)
    by_layer = ", ".join(f"{name} {n / n_events:.2f}" for name, n in spikes.items())
    n_added = f"{sum(additions.values()) / n_events:,.0f}"
    assert "ns an event into the network" in text
    last = f"one event causes spikes in layer {by_layer}; {n_added} weights added"
    assert text.splitlines()[-1] == last


def test_check_compares_spikes_and_membranes(program, model, monkeypatch):
    code, text, _ = program("check", "3", "--model", model, "--prefixes", "3")
    assert code == 0 and "spikes against reference" in text and "membranes against" in text
    counts = SpikingVolume.spike_counts

    def wrong(self):
        numbers = counts(self)
        numbers[-1] += 1
        return numbers

    monkeypatch.setattr(SpikingVolume, "spike_counts", wrong)
    code, text, _ = program("check", "3", "--model", model, "--prefixes", "3")
    assert code == 1 and "FAILS" in text and "NOT equal" in text


def test_evaluate_plot_and_a_folder(program, model, tmp_path):
    for name in MODEL.classes:
        (tmp_path / "set" / name).mkdir(parents=True)
        (tmp_path / "set" / name / "3.npy").write_bytes(SAMPLE.read_bytes())
        np.save(tmp_path / "set" / name / "3.npy", open_recording(SAMPLE).read())
    code, text, _ = program("evaluate", model, tmp_path / "set", "--json")
    report = json.loads(text)
    assert code == 0 and report["recordings"] == 3 and report["accuracy"] == pytest.approx(1 / 3)
    pytest.importorskip("matplotlib", reason="needs the extra `plot`")
    code, _, _ = program("plot", "3", "--model", model, "--out", tmp_path / "p.png")
    assert code == 0 and (tmp_path / "p.png").stat().st_size > 10_000


# -- NIR graphs ------------------------------------------------------------------------------------


@pytest.fixture
def graph(tmp_path):
    nir = pytest.importorskip("nir", reason="needs the extra `nir`")
    made = random_spiking_model(3, CONFIG, ops=("if",))
    nir.write(tmp_path / "net.nir", to_nir(made))
    return tmp_path / "net.nir"


def test_a_graph_becomes_a_model_and_a_graph_again(program, graph, tmp_path):
    pytest.importorskip("nir", reason="needs the extra `nir`")
    layers = random_spiking_model(3, CONFIG, ops=("if",)).layers
    reset = next(layer["reset"] for layer in layers if "reset" in layer)
    out = tmp_path / "m.safetensors"
    words = ("--reset", reset, "--classes", "a, b,c", "--window-us", "200000")
    code, text, error = program("export", graph, "--out", out, *words)
    assert code == 0 and not error and text.startswith(f"{out} (")
    model = load_model(out)
    assert model.classes == ("a", "b", "c") and model.config == CONFIG
    again = tmp_path / "again.nir"
    code, text, _ = program("export", out, "--out", again, "--json")
    assert code == 0 and json.loads(text)["files"] == {str(again): again.stat().st_size}
    code, _, _ = program("export", again, "--out", tmp_path / "n.safetensors", *words)
    assert (tmp_path / "n.safetensors").read_bytes() == out.read_bytes()


def test_a_network_of_relus_goes_to_a_graph_and_back(program, tmp_path):
    graph = tmp_path / "digits.nir"
    code, text, error = program("export", "digits", "--out", graph)
    assert (code, error) == (0, "")
    assert text.startswith(f"{graph} (")
    out = tmp_path / "digits.safetensors"
    assert program("export", graph, "--out", out)[0] == 0
    again = load_model(out)
    assert again.network == load_model("digits").network
    head, *_, last = program("info", graph)[1].splitlines()
    assert head.startswith(f"{graph}: NIR graph of a network of ReLUs, 12 nodes")
    assert last == f"  a model of it: async-tnt export {graph} --out FILE.safetensors"


def test_info_lists_the_nodes_of_a_graph(program, graph):
    code, text, _ = program("info", graph)
    head, *nodes, last = text.splitlines()
    assert code == 0 and head.startswith(f"{graph}: NIR graph, {len(nodes)} nodes, ")
    assert (
        "Input" in nodes[0] and "Output reads" in nodes[-1] and last.startswith("  a model of it")
    )
    report = json.loads(program("info", graph, "--json")[1])
    assert len(report["nodes"]) == len(nodes)


def test_info_lists_a_graph_with_a_circle_and_its_large_fields(program, tmp_path):
    """Fields of more than four numbers are given by their shape; --json has all numbers."""
    nir = pytest.importorskip("nir", reason="needs the extra `nir`")
    graph = nir.NIRGraph(
        {
            "input": nir.Input({"input": np.array([2])}),
            "small": nir.Linear(np.ones((2, 2))),
            "large": nir.Linear(np.ones((1, 5))),
            "output": nir.Output({"output": np.array([2])}),
        },
        [("input", "small"), ("small", "large"), ("large", "small"), ("small", "output")],
        type_check=False,
    )
    nir.write(tmp_path / "net.nir", graph)
    code, text, _ = program("info", tmp_path / "net.nir")
    head, *nodes, _ = text.splitlines()
    assert code == 0 and head.endswith("net.nir: NIR graph, 4 nodes, 4 edges")
    words = sorted(" ".join(line.split()) for line in nodes)
    assert words == [
        "input Input",
        "large Linear reads small; weight 1x5",
        "output Output reads small",
        "small Linear reads input, large",
    ]
    report = json.loads(program("info", tmp_path / "net.nir", "--json")[1])
    assert report["nodes"]["small"] == {"type": "Linear", "shapes": {"weight": [2, 2]}}
    assert ["large", "small"] in report["edges"] and len(report["edges"]) == 4


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("run 3 --model GRAPH", "a NIR graph leaves open how neurons are reset: `async-tnt export"),
        ("check 3 --model GRAPH", "a NIR graph leaves open how neurons are reset: `async-tnt exp"),
        ("export GRAPH --out m.safetensors", "--reset must be subtract or value: NIR leaves open"),
        ("export GRAPH --out m.onnx --reset value", "m.onnx: its name must end in .safetensors"),
        ("export digits-everywhere --out m.nir", "layer 'log1p' (log1p): NIR 1.0 has no such node"),
        ("export digits --out m.nir --polarity on_first", "--polarity is for spiking models, got"),
        ("export digits --out m.onnx --reset value", "--reset is for a .nir graph, got digits"),
        ("export digits --out m.onnx --dt 0.001", "--dt is for a .nir graph, got digits"),
        ("export digits --out m.onnx --polarity off_first", "--polarity is for a .nir graph, got"),
        ("export digits --out m.nir --classes a,b", "--classes is for a .nir graph, got digits"),
        ("export digits --out m.nir --window-us 9", "--window-us is for a .nir graph, got digits"),
        ("export SPIKING --out m.onnx", "must have a network that reads volumes"),
        ("info broken.nir", "broken.nir is not a readable NIR graph"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    words, message, program, graph, model, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.nir").write_bytes(b"no graph")
    places = {"GRAPH": str(graph), "SPIKING": str(model)}
    code, text, error = program(*(places.get(word, word) for word in words.split()))
    assert code == 2 and not text and message in error and error.count("\n") == 1
