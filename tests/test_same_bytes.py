"""The same inputs give the same bytes: whatever the cores, jobs, caches, interruptions and surroundings.

Every comparison is of all files of a result folder but `timing.json`, which is there to differ.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from made_again import read_files
from world import COMMANDS, build_project, find_words

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


def outputs(*running: "subprocess.Popen[str]", codes: Sequence[int] = (0,)) -> list[str]:
    """Return what programs print, after the last of them has ended."""
    ended = [one.communicate(timeout=900) for one in running]
    for one, (_, errors) in zip(running, ended, strict=True):
        assert one.returncode in codes, errors
    return [out for out, _ in ended]


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
@pytest.mark.parametrize("kind", ["cross_validation", "fit"])
def test_a_run_is_the_same_on_one_core_in_other_surroundings(world, kind, new_project, tmp_path):
    expected, place = world.find(kind), new_project("a place with another name")
    home = {"HOME": str(tmp_path), "TMPDIR": str(tmp_path)}
    outputs(
        begin(COMMAND, find_words(kind, place / "out"), place, one_core(), **ELSEWHERE, **home),
        codes=COMMANDS[kind].codes,
    )
    assert_same(place / "out" / expected.name, expected)


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
        outputs(first, second)
        assert_same(alone / words[-1], once / words[-1])
