"""Readers that do what a native reader may do with a damaged file; the child process imports them."""

import mmap
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from needlefit.errors import ConfigError, DataError
from needlefit.project.sandbox import allow_memory


def fills(results, shape, factor):
    values = results.new("values", tuple(shape), "float32")
    values[...] = factor * np.arange(values.size).reshape(shape)
    results.new("more", (3,), "float64")[...] = 0.1
    results.new("none", (0, 3), "float64")
    return {"text": "é", "number": factor}


def crashes(results):
    os.kill(os.getpid(), signal.SIGSEGV)


def is_killed(results):
    os.kill(os.getpid(), signal.SIGKILL)


def leaves(results):
    os._exit(0)


def sleeps(results):
    time.sleep(60)


def writes_its_id_and_sleeps(results, path):
    Path(path).write_text(str(os.getpid()))
    time.sleep(60)


def computes_for_ever(results):
    while True:
        pass


def takes(results, size, granted=0):
    allow_memory(granted)
    return len(mmap.mmap(-1, size))


def fills_the_disk(results):
    results.new("values", (2**40,), "float64")


def raises_data_error(results):
    raise DataError("what", where="where", expected="expected", fix="fix")


def raises_config_error(results):
    raise ConfigError("what")


def raises_another(results):
    raise ValueError("content of the file")


def lacks_a_package(results):
    import no_such_package  # noqa: F401


def prints(results):
    os.write(1, b"noise of a library" * 1000)
    os.write(2, b"noise of a library" * 1000)


def describes_what_it_did_not_write(results, described):
    results.new("values", (8,), "float64")
    results.described = described


def environment(results):
    return [str(Path.cwd()), dict(os.environ), sys.path]
