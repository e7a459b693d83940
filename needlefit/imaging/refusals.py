"""Refuse what cannot be trusted: the errors of the readers and of the steps of a reconstruction."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from needlefit.errors import DataError


def refusal(text: str) -> DataError:
    """Return the error that is written as it is printed: what is wrong, then lines that begin with a key.

    The keys are `expected:`, `fix:` and `where:`, a path or a place in words; where it is left out, `located`
    fills it in. Further lines that are indented go on with what stands before them.
    """
    what, *more = (re.sub(r"\n +", " ", part) for part in re.split(r"\n +(expected|fix|where): ", text))
    return DataError(what, **dict(zip(more[::2], more[1::2], strict=True)))


@contextmanager
def located(where: str | Path) -> Iterator[None]:
    """Give errors that name no place this one: the file that is read, as a rule."""
    try:
        yield
    except DataError as error:
        if error.where:
            raise
        raise error.at(where) from error.__cause__
