"""The notebooks of docs/notebooks run from the first cell to the last."""

import json
from pathlib import Path

import pytest

from async_tnt.training import simulated_pictures

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "docs" / "notebooks").glob("*.ipynb"))
EXPECTED = {
    "classes_from_pictures": lambda names: (
        names["model"].exists() and names["decisions"][0][0] in ("bar", "ring", "cross")
    ),
    "first_steps": lambda names: names["decisions"][-1].label == "7",
    "own_network": lambda names: abs(names["logits"] - names["decision"].logits).max() < 1e-4,
}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_runs(path, monkeypatch, capsys):
    """With a tenth of the recordings of pictures: less is learned from them, in the same way."""
    pytest.importorskip("torch")
    pytest.importorskip("matplotlib").use("Agg")
    monkeypatch.setattr(simulated_pictures, "MOST_TAKES", 20)
    names = {"__name__": "__main__"}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), path.name, "exec"), names)
    assert EXPECTED[path.stem](names)
    import matplotlib.pyplot as plt

    plt.close("all")


def test_every_notebook_is_expected():
    assert {path.stem for path in NOTEBOOKS} == set(EXPECTED)
