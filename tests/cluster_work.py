"""Tasks that workers of other processes import."""

import os
import signal
import time
from pathlib import Path

from needlefit.errors import ConfigError
from needlefit.project.tasks import stop_requested


def square(number, offset=0.0):
    return number**2 + offset


def fail(number):
    raise ConfigError(f"of task {number}", where="here")


def nap(seconds):
    time.sleep(seconds)
    return seconds


def kill_once(number, folder):
    """Return the number; the first task of all kills its worker."""
    try:
        (Path(folder) / "killed").touch(exist_ok=False)
    except FileExistsError:
        return number
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def calculate(seconds):
    """Use the processor for so long, by its own clock; return the time."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return seconds


def wait_for_stop(seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end and not stop_requested():
        time.sleep(0.01)
