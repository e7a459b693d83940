"""What is refused: the error of a call."""

import pytest

from needlefit.errors import DataError


def refusal(kind, words, call, *given, **more):
    """Return the error of a kind that a call ends with, whose text matches `words`."""
    with pytest.raises(kind, match=words or None) as caught:
        call(*given, **more)
    return caught.value


def refused_file(read, path, *given, **more):
    """Return the error of a file that cannot be read: it names the file and says what is to be done."""
    error = refusal(DataError, "", read, path, *given, **more)
    assert error.what and error.where.startswith(str(path)) and error.expected and error.fix
    return error
