"""A Dask scheduler and its workers, as processes of this machine."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def start_process(*words):
    """Start a module as a program; end it, with what it started, after the block."""
    paths = [str(Path(__file__).parent.parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    one = subprocess.Popen(
        [sys.executable, "-m", *words],
        start_new_session=True, stderr=subprocess.DEVNULL, env=environment,
    )  # fmt: skip
    try:
        yield one
    finally:
        with suppress(ProcessLookupError):
            os.killpg(one.pid, signal.SIGKILL)
        one.wait()


@contextmanager
def start_scheduler(folder):
    """Start a scheduler; its address and its process."""
    file = folder / "scheduler.json"
    words = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    with start_process("distributed.cli.dask_scheduler", *words) as one:
        deadline = time.monotonic() + 60
        while not (address := _read_address(file)):
            assert time.monotonic() < deadline and one.poll() is None
            time.sleep(0.05)
        file.unlink()
        yield address, one


def _read_address(file):
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError):  # not written yet, or not to its end
        return ""


def start_worker(address):
    """Start a worker of one thread, with the process that starts it again when it is killed."""
    words = (address, "--nthreads", "1", "--no-dashboard", "--nanny", "--memory-limit", "0")
    return start_process("distributed.cli.dask_worker", *words)
