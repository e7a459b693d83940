"""How far a long run is, and the time left: a bar on a terminal, otherwise a line a minute; on stderr."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TextIO

Report = Callable[[str, int, int], None]
Clock = Callable[[], float]
LINE_INTERVAL_SECONDS = 60.0

MIN_ESTIMATE_SECONDS = 10.0
"""Time after which the remaining time is estimated; before, importing and reading are most of it."""


@contextmanager
def show_progress(quiet: bool = False) -> Iterator[Report]:
    """Yield the function that a run calls with what it does, how many steps are done, and of how many."""
    if quiet:
        yield lambda label, done, total: None
    elif sys.stderr.isatty():
        with _bar() as report:
            yield report
    else:
        yield report_lines(sys.stderr)


@dataclass
class RemainingTime:
    """Estimates the remaining time of a run from the time that its steps took so far.

    Steps are identified by their total: a run that counts two things, such as starts and steps of a sampler,
    has two estimates.
    """

    clock: Clock = time.monotonic
    _begins: dict[int, tuple[float, int]] = field(default_factory=dict)

    def estimate(self, done: int, total: int) -> float | None:
        """Return the seconds left, None while too little is known."""
        now = self.clock()
        begin, first = self._begins.setdefault(total, (now, done))
        if done < first:  # counted again from the start
            self._begins[total] = (now, done)
            return None
        if done == first or now - begin < MIN_ESTIMATE_SECONDS:
            return None
        return (now - begin) * (total - done) / (done - first)


def format_remaining(seconds: float | None) -> str:
    """Return the remaining time as the end of a line; empty if it is not known."""
    if seconds is None:
        return ""
    minutes = round(seconds / 60)
    if minutes < 2:
        return f", about {max(10, 10 * round(seconds / 10))} s left"
    return f", about {minutes} min left" if minutes < 120 else f", about {round(minutes / 60)} h left"


def report_lines(stream: TextIO, clock: Clock = time.monotonic) -> Report:
    """Return a reporter that writes at most one line a minute."""
    lock, last = threading.Lock(), [clock()]
    remaining = RemainingTime(lambda: now[0])
    now = list(last)

    def report(label: str, done: int, total: int) -> None:
        with lock:
            now[0] = clock()
            left = remaining.estimate(done, total)
            if now[0] - last[0] < LINE_INTERVAL_SECONDS:
                return
            last[0] = now[0]
            print(f"needlefit: {label}: {done} of {total}{format_remaining(left)}", file=stream, flush=True)

    return report


@contextmanager
def _bar() -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    remaining = RemainingTime()
    # without its thread: a process with threads is not forked (`project.tasks`)
    with Progress(
        *columns,
        TextColumn("{task.fields[left]}"),
        console=Console(stderr=True),
        transient=True,
        auto_refresh=False,
    ) as bar:
        task = bar.add_task("starting", total=None, left="")

        def report(label: str, done: int, total: int) -> None:
            left = format_remaining(remaining.estimate(done, total)).removeprefix(", ")
            bar.update(task, description=label, completed=done, total=total, left=left, refresh=True)

        yield report
