"""What long computations call: progress, stop and note, and defaults that do nothing."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]  # called with what is done, how much of it, of how much
Step = Callable[[int, int], None]  # called with how much is done, of how much
Stop = Callable[[], bool]

Note = Callable[[str], None]
"""Given a line that the user should read, and that is no result: what was damaged and computed again; or the
stage that begins."""


def no_progress(_what: str, _done: int, _of: int) -> None:
    """Tell nobody."""


def no_step(_done: int, _of: int) -> None:
    """Tell nobody."""


def never_stop() -> bool:
    """Say that nobody wants to stop."""
    return False


def no_note(_line: str) -> None:
    """Pass a line to nobody."""
