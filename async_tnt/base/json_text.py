"""A strict reader of JSON from outside, which refuses a text with a message of one line."""

from __future__ import annotations

import json
from typing import Any

from async_tnt.base.messages import one_line, short

MAX_JSON_DEPTH = 100
"""How deep lists and objects may be nested. Python's own reader and writer of JSON raise a
RecursionError at some thousand levels."""


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text that comes from outside.

    Raises
    ------
    ValueError : the text is not JSON; it is nested deeper than `MAX_JSON_DEPTH`; a whole number has
        thousands of digits; or an object has a name twice (Python would silently use the last
        value). The message is one line.

    Examples
    --------
    >>> parse_json('{"bins": 9}')
    {'bins': 9}
    """
    try:
        value = json.loads(text, object_pairs_hook=_json_object)
    except RecursionError:
        raise ValueError(_TOO_DEEP_MESSAGE) from None
    except _JsonError:
        raise
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"it is not JSON: {one_line(error)}") from None
    except ValueError:  # Python's limit of digits
        raise ValueError(
            "it has a whole number of thousands of digits; expected numbers of float64 or int64"
        ) from None
    _check_depth(value)
    return value


_TOO_DEEP_MESSAGE = f"its JSON is nested more than {MAX_JSON_DEPTH} deep"


class _JsonError(ValueError):
    """The error of `_json_object`. Its message is complete, unlike those of Python's reader."""


def _json_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object as a dict; no name may occur twice."""
    values: dict[str, Any] = {}
    for name, value in pairs:
        if name in values:
            raise _JsonError(f"it names {short(name)} twice in one object")
        values[name] = value
    return values


def _check_depth(value: Any) -> None:
    """Refuse a value with more than `MAX_JSON_DEPTH` lists and objects within each other."""
    level = [value]
    for _ in range(MAX_JSON_DEPTH):
        next_level: list[Any] = []
        for item in level:
            if type(item) is dict:
                next_level += item.values()
            elif type(item) is list:
                next_level += item
        level = [item for item in next_level if type(item) in (dict, list)]
        if not level:
            return
    raise ValueError(_TOO_DEEP_MESSAGE)
