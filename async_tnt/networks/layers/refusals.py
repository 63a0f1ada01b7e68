"""The parts of a network that cannot become layers, collected for one message."""

from __future__ import annotations

MOST_KINDS = 10
"""Most kinds of refused parts that a message names."""


class RefusedError(NotImplementedError):
    """A part of a network that has no compiled form.

    Parameters
    ----------
    kind : the same for all parts that are refused for one reason.
    message : names the part, and says why it is refused.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class Refusals:
    """The refused parts that were found so far, by kind."""

    def __init__(self) -> None:
        self._kinds: dict[str, list[RefusedError]] = {}

    def __bool__(self) -> bool:
        return bool(self._kinds)

    def add(self, error: RefusedError) -> None:
        """Note one more refused part."""
        self._kinds.setdefault(error.kind, []).append(error)

    def raise_if_any(self) -> None:
        """Raise an error that names the first part of each kind and counts the others.

        Raises
        ------
        NotImplementedError : a part was refused.
        """
        if not self._kinds:
            return
        kinds = list(self._kinds.values())
        texts = []
        for errors in kinds[:MOST_KINDS]:
            count = f" ({len(errors)} of these)" if len(errors) > 1 else ""
            texts.append(f"{errors[0]}{count}")
        if len(kinds) > MOST_KINDS:
            n_more = len(kinds) - MOST_KINDS
            texts.append(f"and {n_more} more {'kind' if n_more == 1 else 'kinds'}")
        raise NotImplementedError("; ".join(texts))
