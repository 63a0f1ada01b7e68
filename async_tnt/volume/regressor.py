"""Checks of a regressor: a callable from a raw volume to a point, the landmark `regressor`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterTypeError, ParameterValueError
from async_tnt.base.messages import short
from async_tnt.volume.config import TNTConfig

Regressor = Callable[[np.ndarray], Any]


def check_regressor(config: TNTConfig, regressor: Any) -> None:
    """Refuse a stream that lacks the regressor it needs, or has a regressor that it does not need.

    The configuration says whether a regressor is needed.
    """
    if not isinstance(config, TNTConfig):
        is_model = isinstance(getattr(config, "config", None), TNTConfig)
        hint = "pass its `config`" if is_model else "load_model(name).config is that of a model"
        raise ParameterTypeError("config", "must be a TNTConfig", f"{short(config)}; {hint}")

    setting = f"landmark={config.landmark!r}, transform={config.transform!r}"
    if regressor is None and config.needs_regressor:
        rule = (
            f"is missing: {setting} needs a callable from a raw volume to (x, y); "
            "a Model brings its own, CompiledRegressor(model)"
        )
        raise ParameterValueError("regressor", rule)
    if regressor is None:
        return
    if not callable(regressor):
        raise ParameterTypeError("regressor", "must be callable", type(regressor).__name__)
    if not config.needs_regressor:
        rule = 'needs landmark="regressor" and transform="tnt"'
        raise ParameterValueError("regressor", rule, setting)


def checked_landmark(answer: Any) -> tuple[float, float]:
    """A regressor's answer, a landmark (x, y), as two floats.

    Raises
    ------
    ParameterValueError : `answer` is not two numbers, or one of the numbers is not finite.
    """
    try:
        x, y = map(float, answer)
    except (TypeError, ValueError, OverflowError):
        rule = "must return two numbers (x, y) in grid pixels"
        raise ParameterValueError("regressor", rule, short(answer)) from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ParameterValueError("regressor", "must return a finite landmark", (x, y))
    return x, y
