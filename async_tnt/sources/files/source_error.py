"""The error of a source that cannot be read as the caller's parameters say."""

from __future__ import annotations

import re
from collections.abc import Mapping

from async_tnt.base.checks import ParameterValueError


class SourceError(ParameterValueError):
    """A source and the parameters do not fit each other.

    The message begins with the name of the source and says which parameter to change. If a file
    states something wrong, the error is a plain ValueError instead.

    Parameters
    ----------
    name : name of the source, such as a path; "" where the message has none.
    rule : the rest of the message. Names of parameters stand in braces: "give {sensor}".

    Examples
    --------
    >>> error = SourceError("a.npy", "its pixels are not known: give {sensor}")
    >>> print(error)
    a.npy: its pixels are not known: give `sensor`
    >>> error.text({"sensor": "SENSOR"})
    'a.npy: its pixels are not known: give SENSOR'
    """

    def text(self, option_names: Mapping[str, str] | None = None) -> str:
        """The message. Parameters have the names in `option_names`, or else backticks."""
        names = option_names or {}

        def name_of(match: re.Match[str]) -> str:
            return names.get(match[1], f"`{match[1]}`")

        sentence = re.sub(r"\{(\w+)\}", name_of, self.rule)
        return f"{self.name}: {sentence}" if self.name else sentence

    def of(self, name: object, what: str = "") -> SourceError:
        """The same error with this name of the source; `what` begins the sentence."""
        return SourceError(str(name), f"{what}{self.rule}")
