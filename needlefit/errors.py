"""Every error that needlefit raises on purpose.

::

    NeedlefitError          what all of them are; `except NeedlefitError` catches no bug
    ├── ConfigError         a scene, study, fit, recipe or name is wrong        exit 3
    ├── DataError           a dataset is wrong or missing                       exit 3
    ├── ModelError          the model was asked for something it has not        exit 4
    └── FitError            a fit or a chain cannot start or go on              exit 4

A solve that does not converge is no exception: it is a value (`NeedleShape.converged`).
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

_UNPRINTABLE = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What a terminal acts on, shows in another order, or cannot encode; line ends and tabs are none of it."""


MAX_LINE_CHARACTERS = 1000
"""Largest number of characters of a line of a message: what a file holds may have any length."""
MAX_MESSAGE_CHARACTERS = 16_000
"""Largest number of characters of a message."""


class NeedlefitError(Exception):
    """What went wrong, where, what was expected there, and how to fix it.

    Parameters
    ----------
    what : str
        The fault, in a sentence without a full stop.
    where : str or Path
        File, key, line or column; empty if there is none.
    expected : str
        What a right value looks like.
    fix : str
        What the user can do.
    key : str
        Of the configuration file that is read, where only its reader knows which file that is.
    """

    exit_code = 1

    def __init__(
        self, what: str, *, where: str | Path = "", expected: str = "", fix: str = "", key: str = ""
    ) -> None:
        self.what, self.where, self.expected, self.fix, self.key = what, str(where), expected, fix, key
        super().__init__(str(self))

    def __str__(self) -> str:
        where = self.where or (f"key `{self.key}`" if self.key else "")
        head = f"{where}: {self.what}" if where else self.what
        tail = [("expected", self.expected), ("fix", self.fix)]
        return printable("\n".join([head, *(f"  {label}: {text}" for label, text in tail if text)]))

    def replace(self, **parts: str | Path) -> Self:
        """Return the same error with some of its parts changed."""
        return type(self)(**vars(self) | parts)

    def at(self, where: str | Path) -> Self:
        """Return the same error at a place that only its catcher knows, such as a file."""
        return self.replace(where=where)


def printable(text: str) -> str:
    """Return a text as a terminal may show it.

    Control characters are escaped, long lines shortened in the middle: names and cells of a file get there.
    """
    escaped = without_controls(text[: 2 * MAX_MESSAGE_CHARACTERS])  # before lines are measured: \udc80 is one
    whole = "\n".join(_shortened(line) for line in escaped.split("\n"))
    if len(text) <= 2 * MAX_MESSAGE_CHARACTERS and len(whole) <= MAX_MESSAGE_CHARACTERS:
        return whole
    return f"{whole[:MAX_MESSAGE_CHARACTERS]}\n... ({len(text)} characters in all)"


def without_controls(text: str) -> str:
    """Return a text whose control characters, but for the ends of lines, are escaped."""
    return _UNPRINTABLE.sub(_escaped, text)


def _escaped(match: re.Match[str]) -> str:
    return match[0].encode("unicode_escape").decode("ascii")


def _shortened(line: str) -> str:
    return (
        line
        if len(line) <= MAX_LINE_CHARACTERS
        else f"{line[: MAX_LINE_CHARACTERS // 2]} ... {line[-MAX_LINE_CHARACTERS // 4 :]}"
    )


class ConfigError(NeedlefitError):
    """A scene, study, fit, recipe or name is wrong."""

    exit_code = 3


class UnfinishedWorkError(ConfigError):
    """A run has left finished work, with which `--resume` goes on."""


class DataError(NeedlefitError):
    """A dataset is wrong or missing."""

    exit_code = 3


class ModelError(NeedlefitError):
    """The model was asked for something outside its assumptions."""

    exit_code = 4


class FitError(NeedlefitError):
    """A fit or a chain cannot start or go on."""

    exit_code = 4


@contextmanager
def located(where: str | Path) -> Iterator[None]:
    """Give errors that name no place this one: the file that is read, as a rule."""
    try:
        yield
    except DataError as error:
        if error.where:
            raise
        raise error.at(where) from error.__cause__
