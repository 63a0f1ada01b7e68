"""The files in a run folder, and the learning curves among them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from async_tnt.files import replacing

CHECKPOINT, HISTORY, CURVES = "checkpoint.pt", "history.json", "curves.png"
LAST, BEST = "last.safetensors", "best.safetensors"
RUN_FILES = (CHECKPOINT, HISTORY, CURVES, LAST, BEST)


def plot_curves(history: Sequence[dict[str, float]], path: Path) -> bool:
    """Loss and accuracy against epochs, as PNG. Returns False, and writes nothing, without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return False
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    losses, accuracies = figure.subplots(1, 2)
    epochs = [row["epoch"] for row in history]
    for axes, names in (
        (losses, {"loss": "training (smoothed labels)", "validation_loss": "validation"}),
        (
            accuracies,
            {
                "training": "training (augmented)",
                "per_window": "validation, by window",
                "per_recording": "validation, by recording",
            },
        ),
    ):
        for name, label in names.items():
            if all(name in row for row in history):
                axes.plot(epochs, [row[name] for row in history], marker=".", label=label)
        axes.set_xlabel("epoch")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    losses.set_ylabel("cross entropy")
    accuracies.set_ylabel("accuracy")
    with replacing(path) as part:
        figure.savefig(part, format="png", dpi=120)
    return True
