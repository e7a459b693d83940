"""Which key of a study's file is to blame for what is found wrong only once it is looked up."""

from collections.abc import Iterator
from contextlib import contextmanager

from needlefit.errors import ConfigError


@contextmanager
def blamed(study: str, key: str = "") -> Iterator[None]:
    """Have every ConfigError from within that names no place name this study, and the key of its file."""
    try:
        yield
    except ConfigError as error:
        if error.where:
            raise
        error.key = error.key or key
        raise error.at(place(study, error.key)) from None


def place(study: str, key: str = "") -> str:
    """Return how messages call a key of a study's file."""
    return f"study {study}, key `{key}`" if key else f"study {study}"
