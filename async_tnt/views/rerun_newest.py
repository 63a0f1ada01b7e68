"""A decision as text for the viewer: the class in large letters, and the probabilities as bars with their names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from async_tnt.decision import Decision

MOST_BARS = 12  # of more classes, the likeliest are shown
BAR_LENGTH = 14
MOST_LETTERS = 16  # of a class name beside its bar
EIGHTHS = " ▏▎▍▌▋▊▉"


def newest_text(decision: Decision, classes: Sequence[str]) -> str:
    """Markdown: what the open window is taken for at this moment.

    Parameters
    ----------
    decision : of any trigger.
    classes : the names, as many as there are probabilities.
    """
    if decision.events == 0:
        return "# no event\n\nThe window has no event yet."
    length_ms = (decision.time_us - decision.window_start_us) / 1e3
    return (
        f"# {plain(decision.label)}\n\nwith probability {decision.probability:.3f}, from {decision.events:,} events in "
        f"{length_ms:,.1f} ms\n\n```\n{bars(decision.probabilities, classes)}\n```"
    )


def bars(probabilities: np.ndarray, classes: Sequence[str]) -> str:
    """A line for each class: its name, a bar, the probability. All in the classes' order, or the likeliest first.

    Examples
    --------
    >>> print(bars(np.array([0.25, 0.75]), ["cat", "mouse"]))
    cat   ███▌           0.250
    mouse ██████████▌    0.750
    """
    shown = list(range(len(classes)))
    if len(classes) > MOST_BARS:
        shown = np.argsort(-probabilities, kind="stable")[:MOST_BARS].tolist()
    names = [_short(classes[k]) for k in shown]
    width = max(map(len, names))
    lines = []
    for name, k in zip(names, shown, strict=True):
        n_eighths = round(float(probabilities[k]) * BAR_LENGTH * 8)
        bar = "█" * (n_eighths // 8) + EIGHTHS[n_eighths % 8].strip()
        lines.append(f"{name:{width}} {bar:{BAR_LENGTH}} {probabilities[k]:.3f}")
    return "\n".join(lines)


def plain(text: str) -> str:
    """Markdown that shows the text itself, on one line."""
    return "".join(f"\\{c}" if c in r"\`*_{}[]<>()#+-.!|~&$" else c for c in " ".join(text.split()))


def _short(name: str) -> str:
    name = " ".join(name.replace("`", "'").split())  # three of them would end the block of bars
    return name if len(name) <= MOST_LETTERS else name[: MOST_LETTERS - 1] + "…"
