"""What the tests of the figures share: subjects to draw."""

from __future__ import annotations

import numpy as np

import async_tnt
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.views.figure_subject import Subject


def sample(digit: int = 3) -> np.ndarray:
    """The events of a bundled recording."""
    return open_recording(sample_recordings()[digit]).read()


def subject(digit: int = 3, **changes) -> Subject:
    """A bundled recording as the bundled model sees it, or with a changed configuration."""
    model = async_tnt.load_model("digits")
    return Subject(f"{digit}.bin", sample(digit), model.config.replace(**changes), model, "digits")
