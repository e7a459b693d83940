"""Reading files in the process of the test, for tests of what is read, not of the process that reads it.

A child process for each file costs a quarter of a second. A test that needs one uses the fixture
`child_process_reader`.
"""

import json
import warnings

import pytest

from needlefit.project import sandbox as cage


@pytest.fixture
def child_process_reader():
    """Ask for the child process, its limits among them."""


@pytest.fixture
def read_here(request, monkeypatch):
    """Let requests be answered by what the child process runs, without its limits and without the process."""
    if "child_process_reader" in request.fixturenames:
        return

    def answer(asked, file, shared, allowed):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # as the child's are, which nobody sees
            return json.dumps(cage._attempt(asked)).encode("ascii")

    monkeypatch.setattr(cage, "_set_limits", lambda allowed: None)
    monkeypatch.setattr(cage, "_run", answer)
