"""What long work is given to tell how far it is, and to ask whether to stop; and what stands for nobody."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Told what is being done, how much of it is done, and of how much."""

Stop = Callable[[], bool]

Note = Callable[[str], None]
"""Given a line that the user should read, and that is no result: what was damaged and computed again."""


def silent(_what: str, _done: int, _of: int) -> None:
    """Tell nobody."""


def never() -> bool:
    """Say that nobody wants to stop."""
    return False


def unheard(_line: str) -> None:
    """Pass a line to nobody."""
