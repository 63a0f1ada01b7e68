"""The parser of the command line, and the mistakes that it explains in one line."""

from __future__ import annotations

import argparse
import difflib
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NoReturn

from async_tnt.base.messages import printable

OPTION_LIKENESS = 0.7
"""The least likeness, from 0 to 1, of a mistyped option and the option that is suggested. See
`difflib`."""
COMMAND_LIKENESS = 0.6
"""The least likeness of a mistyped command and the command that is suggested. The limit for options
is higher, because all options begin with two dashes."""


class Parser(argparse.ArgumentParser):
    """A parser that reports a mistake in one line, as all commands do.

    Attributes
    ----------
    commands : name of a command -> the parser of its options.
    correction : a mistyped word of the command line, and the word that was probably meant; None if
        no word is mistyped. The message of `error` suggests the second word.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.commands: dict[str, Parser] = {}
        self.correction: tuple[str, str] | None = None

    @property
    def options(self) -> list[str]:
        """All options, such as "--out"."""
        return [option for action in self._actions for option in action.option_strings]

    @property
    def option_names(self) -> dict[str, str]:
        """The option that gives each parameter, such as "--every-us" for "every_us"."""
        return {
            action.dest: action.option_strings[-1]
            for action in self._actions
            if action.option_strings
        }

    def error(self, message: str) -> NoReturn:
        """Print a mistake in one line, and end the program with exit code 2."""
        if self.correction is not None:
            word, suggestion = self.correction
            if word in message:
                message = f"{message}; did you mean {suggestion}?"
            else:
                message = f"{message}; {word}: did you mean {suggestion}?"
        self.exit(2, f"{self.prog}: {printable(message)} ({self.prog} --help)\n")


def refuse_dashes(parser: Parser, argv: Sequence[str]) -> None:
    """Refuse --option=--, for which argparse would give the command an empty list, not a text."""
    for word in _before_files(argv):
        if word.startswith("-") and word.endswith("=--"):
            option = word.removesuffix("=--")
            parser.error(f"argument {option}: expected a value, got '--'")


def refuse_removed(parser: Parser, argv: Sequence[str], removed: Mapping[str, str]) -> None:
    """Refuse an option of the previous version that no longer exists.

    The error says what to write instead.

    Parameters
    ----------
    removed : option -> what to write instead, such as {"--bins": "write --volume bins=N"}.
    """
    for word in _before_files(argv):
        name = word.partition("=")[0]
        if name in removed:
            parser.error(f"{name} is no longer an option: {removed[name]}")


def find_mistyped(
    words: Sequence[str], options: Sequence[str], commands: Sequence[str] = ()
) -> tuple[str, str] | None:
    """Find the first word that is nearly an option or a command, but not quite.

    Parameters
    ----------
    words : the words of the command line, as they were typed.
    options : the options that exist.
    commands : the commands that exist. If they are given, the first word that does not look like an
        option is compared with them, and the words after it are not examined.

    Returns
    -------
    The word, and the word that was probably meant; None if there is no such word.

    Examples
    --------
    >>> find_mistyped(["a.npz", "--modle", "x"], ["--model", "--out"])
    ('--modle', '--model')

    The beginning of an option is no mistake, because argparse takes it for the option:

    >>> find_mistyped(["a.npz", "--mod", "x"], ["--model", "--out"]) is None
    True
    """
    for word in _before_files(words):
        if _is_option(word):
            name = word.partition("=")[0]
            if any(option.startswith(name) for option in options):
                continue
            suggestion = _nearest(name, options, OPTION_LIKENESS)
            if suggestion is not None:
                return name, suggestion
        elif commands:
            # the first such word is the command, and what follows belongs to it
            suggestion = None if word in commands else _nearest(word, commands, COMMAND_LIKENESS)
            return None if suggestion is None else (word, suggestion)
    return None


def _before_files(words: Iterable[str]) -> Iterator[str]:
    """The words before `--`, after which there are only files."""
    return itertools.takewhile(lambda word: word != "--", words)


def _is_option(word: str) -> bool:
    """Whether a word looks like an option. A negative number does not."""
    return len(word) > 1 and word.startswith("-") and not word[1].isdigit()


def _nearest(word: str, candidates: Sequence[str], likeness: float) -> str | None:
    """The candidate that is most like `word`; None if no candidate reaches `likeness`."""
    matches = difflib.get_close_matches(word.lower(), candidates, n=1, cutoff=likeness)
    return matches[0] if matches else None
