"""Reading files in the process of the test, for tests of what is read, not of the process that reads it.

A child process for each file costs a quarter of a second. A test that needs one uses the fixture
`child_process_reader`.
"""

import json
import subprocess
import warnings
from types import SimpleNamespace

import pytest

from needlefit.project import reader_process


@pytest.fixture
def child_process_reader():
    """Ask for the child process, its limits among them."""


@pytest.fixture
def read_here(request, monkeypatch):
    """Let requests be answered by what the child process runs, without its limits and without the process."""
    if "child_process_reader" in request.fixturenames:
        return

    def answer(command, stdout, **_):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # as the child's are, which nobody sees
            reader_process.write_answer(json.loads(command[-1])[1], stdout)
        return subprocess.CompletedProcess(command, 0)

    processes = SimpleNamespace(run=answer, DEVNULL=None, TimeoutExpired=subprocess.TimeoutExpired)
    monkeypatch.setattr(reader_process, "_set_limits", lambda *_: None)
    monkeypatch.setattr(reader_process, "subprocess", processes)
