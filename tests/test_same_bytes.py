"""The same inputs give the same bytes: whatever the cores, jobs, caches, interruptions and surroundings.

Every comparison is of all files of a result folder but `timing.json`, which is there to differ.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

from needlefit.mechanics.kernel.cache import CACHE_DIR_VARIABLE, find_cache_folder
from needlefit.project.locate import find_file
from needlefit.project.threads import THREAD_VARIABLES as THREADS
from tests.cluster_processes import start_scheduler, start_worker

STUDY = """\
schema = 1
title = "Reduced"
paper_study = 3
dataset = "twin"
medium = "phantom2"
recipe = "small"
paper_parameters = "study3"
tune = {{ medium = "phantom2", layers = {tuned} }}
validate = [{{ medium = "{other}", layers = {held_out} }}]
"""
STUDIES = {
    "small": STUDY.format(tuned='[3], insertions = ["phantom2-14"]', other="phantom1", held_out="[3]"),
    "tiny": STUDY.format(tuned="[2]", other="phantom2", held_out="[1]"),
}
"""The smaller one has too few points for BLAS to share them out among threads."""

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
    """Start a program in a folder, with the compiled functions of this process and no limit of threads."""
    environment = {name: value for name, value in os.environ.items() if name not in THREADS}
    environment |= {CACHE_DIR_VARIABLE: str(find_cache_folder().path.parent), **HERE, **settings}
    return subprocess.Popen(
        (sys.executable, "-c", program, cores, *words),
        cwd=place, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


UNCONVERGED = 5
"""Exit code of a posterior that has not converged: its bytes count as others' do."""


def outputs(*running: "subprocess.Popen[str]", codes: Sequence[int] = (0,)) -> list[str]:
    """Return what programs print, after the last of them has ended."""
    ended = [one.communicate(timeout=900) for one in running]
    for one, (_, errors) in zip(running, ended, strict=True):
        assert one.returncode in codes, errors
    return [out for out, _ in ended]


def output(running: "subprocess.Popen[str]", codes: Sequence[int] = (0,)) -> str:
    return outputs(running, codes=codes)[0]


def contents(place: Path) -> dict[str, bytes]:
    files = [path for path in place.rglob("*") if path.is_file() and path.name != "timing.json"]
    assert files
    return {str(path.relative_to(place)): path.read_bytes() for path in files}


def assert_same(found: Mapping[str, bytes], expected: Mapping[str, bytes]) -> None:
    """A difference is reported by the files' names: their bytes are many."""
    assert found.keys() == expected.keys()
    assert [name for name in expected if found[name] != expected[name]] == []


@pytest.fixture(scope="module")
def new_project(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return what makes a project in a folder of some name; its results are the same wherever it lies."""

    def made(name: str) -> Path:
        place = tmp_path_factory.mktemp(name)
        (place / "studies").mkdir()
        for study, text in STUDIES.items():
            (place / f"studies/{study}.toml").write_text(text, encoding="utf-8")
        (place / "configs/recipes").mkdir(parents=True)
        recipe = find_file("recipe", "quick").read_text(encoding="utf-8").replace("starts = 4", "starts = 2")
        (place / "configs/recipes/small.toml").write_text(recipe, encoding="utf-8")
        return place

    return made


# --- a program that uses the package: seconds, so this one is always run

PROGRAM = (
    ON_CORES
    + """
import hashlib, pickle
import numpy as np
from needlefit.project.load import load
from needlefit.schemas.study import StudyRecord
from needlefit.studies.kinds.cross_validation.results import COLUMNS
from needlefit.studies.kinds.cross_validation.run import Settings, run
from pathlib import Path
results = run("small", load(Path("studies/tiny.toml"), StudyRecord), Settings(jobs=int(sys.argv[2])))
for name in COLUMNS:
    print(name, hashlib.sha256(results.frames[name].to_csv().encode()).hexdigest())
print("run", results.run)
"""
)


@pytest.mark.slow
def test_a_run_is_the_same_on_one_core_in_other_surroundings_and_with_other_jobs(new_project):
    first = begin(PROGRAM, ["2"], new_project("here"))
    second = begin(PROGRAM, ["1"], new_project("there"), one_core(), **ELSEWHERE)
    here, there = outputs(first, second)
    assert here.splitlines() == there.splitlines()


# --- whole commands


@pytest.fixture(scope="module")
def validated(new_project) -> dict[str, bytes]:
    place = new_project("once")
    output(begin(COMMAND, ["validate", "small", "--jobs", "2", "--out", "out"], place))
    return contents(place / "out")


VALIDATE = ["validate", "small", "--out", "out"]


@pytest.mark.slow
def test_validate_is_the_same_on_one_core_in_other_surroundings(new_project, validated, tmp_path):
    assert {"small/predictive.csv", "small/bands.csv", "small/report.pdf"} & validated.keys()
    place = new_project("a place with another name")
    home = {"HOME": str(tmp_path), "TMPDIR": str(tmp_path)}
    output(begin(COMMAND, VALIDATE, place, one_core(), **ELSEWHERE, **home))
    assert_same(contents(place / "out"), validated)


@pytest.mark.slow
def test_two_first_starts_at_once_are_as_a_later_one(new_project, validated, tmp_path):
    places = [new_project("cold") for _ in range(2)]
    cold = {CACHE_DIR_VARIABLE: str(tmp_path / "cache")}
    outputs(*(begin(COMMAND, VALIDATE, place, **cold) for place in places))
    for place in places:
        assert_same(contents(place / "out"), validated)


@pytest.mark.slow
def test_programs_that_compile_at_the_same_time_are_as_one_that_loads(new_project, tmp_path):
    """Both compile in their own process, and fill one folder."""
    places = [new_project("compiling") for _ in range(2)]
    cold = {CACHE_DIR_VARIABLE: str(tmp_path / "cache")}
    found = outputs(*(begin(PROGRAM, ["2"], place, **cold) for place in places))
    warm = output(begin(PROGRAM, ["2"], new_project("loading")))
    assert [one.splitlines() for one in found] == [warm.splitlines()] * 2


def wait_for(running: "subprocess.Popen[str]", pattern: str, place: Path) -> None:
    """Wait until a command has kept something of its work."""
    deadline = time.monotonic() + 600
    while not any(path.stat().st_size for path in place.glob(pattern)):
        assert running.poll() is None and time.monotonic() < deadline
        time.sleep(0.005)


def kill_when(running: "subprocess.Popen[str]", pattern: str, place: Path) -> None:
    """Kill a command as soon as it has kept something of its work."""
    wait_for(running, pattern, place)
    running.send_signal(signal.SIGKILL)
    running.communicate()
    assert running.returncode == -signal.SIGKILL


@pytest.mark.slow
def test_validate_killed_and_resumed_is_the_same(new_project, validated):
    place = new_project("killed")
    kill_when(begin(COMMAND, VALIDATE, place, one_core()), "out/small.partial/*.jsonl", place)
    output(begin(COMMAND, [*VALIDATE, "--resume"], place, **ELSEWHERE))
    assert_same(contents(place / "out"), validated)


SAMPLE = ["tune", "small", "--sample", "--out", "out"]


LEFT_OUT = """\
schema = 1
kind = "left_out"
fits = ["shallow"]
groups = ["insertion"]
same_specimen = true
"""
SHALLOW = """\
schema = 1
dataset = "twin"
medium = "phantom2"
recipe = "small"
tune = { insertions = ["phantom2-10", "phantom2-15", "phantom2-16"] }
"""


@pytest.mark.slow
def test_an_analysis_is_the_same_in_one_process_in_two_and_on_a_cluster_that_loses_a_worker(new_project):
    place, outs = new_project("analysis"), ["one", "two", "cluster"]
    (place / "studies/left.toml").write_text(LEFT_OUT, encoding="utf-8")
    (place / "configs/fits").mkdir()
    (place / "configs/fits/shallow.toml").write_text(SHALLOW, encoding="utf-8")
    with start_scheduler(place) as (address, _), start_worker(address) as doomed, start_worker(address):
        where = [("--jobs", "1"), ("--jobs", "2"), ("--scheduler", address)]
        for out, how in zip(outs, where, strict=True):
            running = begin(COMMAND, ["validate", "left", *how, "--out", out], place)
            if how[-1] == address:
                wait_for(running, f"{out}/left.partial/*.jsonl", place)
                os.killpg(doomed.pid, signal.SIGKILL)
            output(running)
    found = [contents(place / out) for out in outs]
    for one in found[1:]:
        assert_same(one, found[0])


@pytest.mark.slow
def test_a_sampled_posterior_is_the_same_on_one_core_and_after_it_was_killed(new_project):
    once, alone, killed = (new_project(name) for name in ("once", "alone", "killed"))
    first = begin(COMMAND, [*SAMPLE, "--jobs", "2"], once)
    second = begin(COMMAND, SAMPLE, alone, one_core(), **ELSEWHERE)
    outputs(first, second, codes=(0, UNCONVERGED))
    kept = "out/small-tune.partial/*.posterior/*.checkpoint"
    kill_when(begin(COMMAND, [*SAMPLE, "--jobs", "2"], killed), kept, killed)
    output(begin(COMMAND, [*SAMPLE, "--jobs", "1", "--resume"], killed), codes=(0, UNCONVERGED))
    expected = contents(once / "out")
    assert "small-tune/posterior.nc" in expected
    assert_same(contents(alone / "out"), expected)
    assert_same(contents(killed / "out"), expected)


@pytest.mark.slow
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
        assert_same(contents(alone / words[-1]), contents(once / words[-1]))


# --- several studies of one command

SEVERAL = (
    ON_CORES
    + """
from pathlib import Path
from needlefit.cli.execution import Execution
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.run_study import plan_studies, run_studies
from needlefit.project.tasks import LocalPool
jobs = int(sys.argv[2])
todo = [*plan_studies("small"), *plan_studies("tiny")]
pool = LocalPool(jobs)
execution = Execution(Invocation(()), Path("reports"), None, jobs, False, lambda: False, pool=pool)
print([one.name for one in run_studies(execution, todo, json=True).runs])
"""
)


@pytest.mark.slow
def test_studies_side_by_side_are_the_same_as_one_after_the_other(new_project):
    places = new_project("one"), new_project("two")
    running = [begin(SEVERAL, [str(jobs)], place) for jobs, place in enumerate(places, start=1)]
    assert outputs(*running) == 2 * ["['small', 'tiny']\n"]
    for study in STUDIES:
        found, expected = (contents(place / "reports" / study) for place in places)
        assert_same(found, expected)
