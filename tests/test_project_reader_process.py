"""Readers in a child process: what they return, and what becomes of those that crash or take too much."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from refusals import refusal

from needlefit.errors import ConfigError, DataError
from needlefit.project import reader_process
from needlefit.project.reader_process import MEMORY_VARIABLE, read_in_process, stated_memory_bytes

MIB = 2**20
FILE = Path("somewhere.nrrd")


@pytest.fixture(autouse=True)
def small_limits(monkeypatch):
    monkeypatch.setattr(reader_process, "READER_BYTES", 64 * MIB)
    monkeypatch.setattr(reader_process, "READER_SECONDS", 1)


def run(reader, **arguments):
    return read_in_process(f"process_readers:{reader}", FILE, arguments)


def refused(reader, error=DataError, **arguments):
    with pytest.raises(error) as found:
        run(reader, **arguments)
    assert found.value.what and found.value.where == str(FILE) and found.value.fix
    return found.value.what


def test_arrays_and_values_come_back():
    value, arrays = run("fills", shape=[2, 3, 4], factor=2)
    assert value == {"text": "é", "number": 2}
    assert np.array_equal(arrays["values"], 2 * np.arange(24).reshape(2, 3, 4))
    assert arrays["values"].dtype == np.float32 and arrays["none"].shape == (0, 3)
    assert arrays["more"].tolist() == [0.1] * 3
    arrays["values"][0, 0, 0] = 5.0  # it is writable, as an array of one's own


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("reader", "word"),
    [
        *(("crashes", "-11"), ("is_killed", "-9"), ("leaves", "code 0"), ("computes_for_ever", "-24")),
        ("answers_with_objects", "code 1"),
    ],
)
def test_a_reader_that_ends_without_a_result_is_a_data_error(reader, word):
    assert word in refused(reader)


@pytest.mark.sweep
def test_a_reader_that_hangs_is_ended(monkeypatch):
    monkeypatch.setattr(reader_process, "WALL_SECONDS", -3.5)
    begin = time.monotonic()
    assert "0.5 s" in refused("sleeps")
    assert time.monotonic() - begin < 10


def test_memory_is_limited_beyond_what_was_granted():
    assert run("takes", size=48 * MIB)[0] == 48 * MIB
    assert "memory" in refused("takes", size=96 * MIB)
    assert run("takes", size=96 * MIB, granted=64 * MIB)[0] == 96 * MIB
    assert "memory" in refused("fills_the_memory")


def test_errors_of_the_reader_are_its_own():
    found = refusal(DataError, "", run, "raises_data_error")
    error = found
    assert (error.what, error.where, error.expected, error.fix) == ("what", "where", "expected", "fix")


def test_another_exception_is_named_and_not_quoted():
    what = refused("raises_another")
    assert "ValueError" in what and "content" not in what


def test_the_child_imports_nothing_from_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("numpy.py").write_text("raise RuntimeError")
    monkeypatch.syspath_prepend("")
    folder, variables, search = run("environment")[0]
    assert folder == str(tmp_path) and "" not in search
    assert variables["OMP_NUM_THREADS"] == "1"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a child outlives a parent that is killed")
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_the_child_ends_with_its_parent(tmp_path, end):
    note = tmp_path / "id"
    here = Path(__file__).parent
    code = (
        f"import signal, sys; sys.path[:0] = [{str(here)!r}, {str(here.parent)!r}]\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell's background jobs ignore it
        "from pathlib import Path; from needlefit.project.reader_process import read_in_process\n"
        "reader = 'process_readers:writes_its_id_and_sleeps'\n"
        f"read_in_process(reader, Path('f'), {{'path': {str(note)!r}}})"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    while not (note.exists() and note.read_text()):
        assert parent.poll() is None
        time.sleep(0.02)
    parent.send_signal(end)
    parent.wait(10)
    child = Path("/proc") / note.read_text()
    wait_until = time.monotonic() + 10
    while child.exists() and "\nState:\tZ" not in (child / "status").read_text():
        assert time.monotonic() < wait_until
        time.sleep(0.02)


@pytest.mark.parametrize(("text", "size"), [("", None), ("2", 2 * 2**30), ("0.5", 2**29)])
def test_the_user_states_the_memory_of_one_file(monkeypatch, text, size):
    monkeypatch.setenv(MEMORY_VARIABLE, text)
    assert stated_memory_bytes() == size


@pytest.mark.parametrize("text", ["much", "-1", "nan", "inf", "0", "9" * 5000])
def test_an_invalid_memory_limit_is_refused(monkeypatch, text):
    monkeypatch.setenv(MEMORY_VARIABLE, text)
    found = refusal(ConfigError, "", stated_memory_bytes)
    assert found.where == MEMORY_VARIABLE and len(found.what) < 100
    assert os.environ[MEMORY_VARIABLE] == text
