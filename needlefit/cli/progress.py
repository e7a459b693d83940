"""How far a long run is, and the time left: a bar on a terminal, otherwise a line a minute; on stderr."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from needlefit.project.progress import Progress, no_progress

LINE_INTERVAL_SECONDS = 60.0


@contextmanager
def show_progress(quiet: bool) -> Iterator[Progress]:
    """Yield the function that a run calls with what it does, how many steps are done, and of how many."""
    if quiet:
        yield no_progress
    elif sys.stderr.isatty():
        with _bar() as report:
            yield report
    else:
        yield report_lines(sys.stderr)


def report_lines(stream: TextIO) -> Progress:
    """Return a reporter that writes at most one line a minute, with the time left at the mean pace."""
    lock, last, first = threading.Lock(), [time.monotonic()], list[tuple[float, int]]()

    def report(label: str, done: int, total: int) -> None:
        with lock:
            now = time.monotonic()
            if not first:  # what an earlier run has done says nothing of the pace
                first.append((now, done))
            if now - last[0] >= LINE_INTERVAL_SECONDS:
                last[0] = now
                (begin, before), left = first[0], ""
                if done > before:
                    minutes = (now - begin) / (done - before) * (total - done) / 60
                    left = f", about {minutes:.0f} min left"
                print(f"needlefit: {label}: {done} of {total}{left}", file=stream, flush=True)

    return report


@contextmanager
def _bar() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    # without its thread: a process with threads is not forked (`project.tasks`)
    with Progress(
        TextColumn("{task.description}"),
        *columns,
        console=Console(stderr=True),
        transient=True,
        auto_refresh=False,
    ) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda label, done, total: bar.update(
            task, description=label, completed=done, total=total, refresh=True
        )
