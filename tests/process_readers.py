"""Readers that do what a native reader may do with a damaged file; the child process imports them."""

import mmap
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from needlefit.errors import DataError
from needlefit.project.reader_process import allow_memory


def fills(arrays, shape, factor):
    arrays["values"] = factor * np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    arrays["more"] = np.full(3, 0.1)
    arrays["none"] = np.empty((0, 3))
    return {"text": "é", "number": factor}


def crashes(arrays):
    os.kill(os.getpid(), signal.SIGSEGV)


def is_killed(arrays):
    os.kill(os.getpid(), signal.SIGKILL)


def leaves(arrays):
    os._exit(0)


def sleeps(arrays):
    time.sleep(60)


def writes_its_id_and_sleeps(arrays, path):
    Path(path).write_text(str(os.getpid()))
    time.sleep(60)


def computes_for_ever(arrays):
    while True:
        pass


def takes(arrays, size, granted=0):
    allow_memory(granted)
    return len(mmap.mmap(-1, size))


def fills_the_memory(arrays):
    arrays["values"] = np.ones(2**37)


def answers_with_objects(arrays):
    arrays["values"] = np.array([{}])


def raises_data_error(arrays):
    raise DataError("what", where="where", expected="expected", fix="fix")


def raises_another(arrays):
    raise ValueError("content of the file")


def environment(arrays):
    return [str(Path.cwd()), dict(os.environ), sys.path]
