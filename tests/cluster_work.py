"""Tasks that workers of other processes import."""

import os
import signal
import time
from pathlib import Path

from needlefit.errors import ConfigError
from needlefit.project.tasks import stop_requested


def square(number: float, offset: float = 0.0) -> float:
    return number**2 + offset


def fail(number: int) -> None:
    raise ConfigError(f"of task {number}", where="here")


def nap(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def kill_once(number: int, folder: str) -> int:
    """Return the number; the first task of all kills its worker."""
    try:
        (Path(folder) / "killed").touch(exist_ok=False)
    except FileExistsError:
        return number
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def calculate(seconds: float) -> float:
    """Use the processor for so long, by its own clock; return the time."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return seconds


def wait_for_stop(seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end and not stop_requested():
        time.sleep(0.01)
