"""Scans and what is reconstructed of them have the same bytes, whatever the cores, jobs and surroundings."""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from made_again import read_files
from world import build_project

from needlefit.project.processes import THREAD_VARIABLES as THREADS

ON_CORES = """
import os, sys
if sys.argv[1] != "all":
    os.sched_setaffinity(0, {int(sys.argv[1])})
"""
COMMAND = ON_CORES + "from needlefit.cli import main\nmain(sys.argv[2:])\n"
HERE = {"PYTHONHASHSEED": "1", "TZ": "UTC", "LC_ALL": "C.UTF-8"}
ELSEWHERE = {
    "PYTHONHASHSEED": "2",
    "TZ": "Pacific/Kiritimati",
    "LC_ALL": "POSIX",
    "PYTHONCOERCECLOCALE": "0",
    "PYTHONUTF8": "0",  # files whose encoding is not named are then ASCII
    "PYTHONIOENCODING": "utf-8",
    "SOURCE_DATE_EPOCH": "1",
    "COLUMNS": "40",
    "OPENBLAS_NUM_THREADS": "2",
}
"""Hash seed, time zone, locale, encodings, the width of a terminal, and a setting that must not be heeded."""


def one_core() -> str:
    return str(min(os.sched_getaffinity(0)))


def begin(
    program: str, words: Sequence[str], place: Path, cores: str = "all", **settings: str
) -> "subprocess.Popen[str]":
    """Start a program in a folder, with no limit of threads."""
    environment = {name: value for name, value in os.environ.items() if name not in THREADS}
    environment |= {**HERE, **settings}
    return subprocess.Popen(
        (sys.executable, "-c", program, cores, *words),
        cwd=place, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def wait(*running: "subprocess.Popen[str]") -> None:
    """Wait until the last of some programs has ended."""
    ended = [one.communicate(timeout=900) for one in running]
    for one, (_, errors) in zip(running, ended, strict=True):
        assert one.returncode == 0, errors


def assert_same(found: Path, expected: Path) -> None:
    """A difference is reported by the files' names: their bytes are many."""
    one, two = read_files(found), read_files(expected)
    assert one.keys() == two.keys() != set()
    assert [name for name in two if one[name] != two[name]] == []


@pytest.fixture
def new_project(tmp_path: Path) -> Callable[[str], Path]:
    """Return what copies the project of the tiny world; its results are the same wherever it lies."""

    def made(name: str) -> Path:
        build_project(tmp_path / name)
        return tmp_path / name

    return made


@pytest.mark.sweep
def test_scans_and_what_is_reconstructed_of_them_are_the_same(new_project):
    """Rendered and reconstructed as `twin build` does it; its other 45 insertions are no other code."""
    pytest.importorskip("SimpleITK")
    once, alone = new_project("once"), new_project("alone")
    render = ["twin", "ct", "phantom1-01", "phantom3-01", "--out", "ct"]
    reconstruct = ["reconstruct", "ct/scans.csv", "--out", "found"]
    for words in (render, reconstruct):
        first = begin(COMMAND, [*words, "--jobs", "2"], once)
        second = begin(COMMAND, [*words, "--jobs", "1"], alone, one_core(), **ELSEWHERE)
        wait(first, second)
        assert_same(alone / words[-1], once / words[-1])
