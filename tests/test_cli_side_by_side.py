"""Studies that run side by side, in copies of the process."""

import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer

from needlefit.cli import execution
from needlefit.cli.execution import Execution, run_studies
from needlefit.cli.exit_codes import Invocation
from needlefit.studies.job import StatedStudy

NAMES = ("first", "second", "third")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """What runs studies of these names, and returns where each ran, which were shown, and what was noted."""
    monkeypatch.chdir(tmp_path)
    shown, jobs_of_each = [], []

    def work(self, study, sample):
        assert self.invocation.jobs == jobs_of_each[-1]
        Path(f"{study.name}.begun").touch()
        time.sleep(0.5 if study.name == "first" else 0.0)  # it ends last
        self._print_note(study.name)
        return SimpleNamespace(name=study.name, interrupted=study.name == "stopped", process=os.getpid())

    monkeypatch.setattr(Execution, "run", work)
    monkeypatch.setattr(Execution, "write", lambda self, run: Path(f"{run.name}.txt").write_text(run.name))
    monkeypatch.setattr(execution, "show_run", lambda asked, run, folder, named: shown.append(run.name))

    def call(jobs, each, *names):
        shown.clear()
        jobs_of_each.append(each)
        asked = Invocation((), jobs=jobs, quiet=True)
        try:
            done = run_studies(Execution(asked), [StatedStudy(name, SimpleNamespace()) for name in names])
        except typer.Exit:
            return [], [*shown]
        return [one.process == os.getpid() for one in done], [*shown], sorted(asked.noted)

    return call


def test_one_job_runs_one_after_another_in_this_process(run):
    assert run(1, 1, *NAMES) == ([True] * 3, [*NAMES], [*NAMES])


@pytest.mark.skipif(sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2, reason="no copies here")
def test_several_run_in_copies_of_it_and_are_shown_in_their_order(run, tmp_path):
    assert run(2, 1, *NAMES) == ([False] * 3, [*NAMES], [*NAMES])
    assert sorted(one.stem for one in tmp_path.glob("*.txt")) == sorted(NAMES)
    assert run(9, 3, *NAMES)[0] == [False] * 3


@pytest.mark.skipif(sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2, reason="no copies here")
def test_the_longest_run_first_and_are_shown_in_their_order(run, tmp_path, monkeypatch):
    monkeypatch.setattr(execution, "_estimate_size", lambda _, study: NAMES.index(study.name))
    assert run(2, 1, *NAMES)[1:] == ([*NAMES], [*NAMES])
    begun = [(tmp_path / f"{name}.begun").stat().st_mtime_ns for name in NAMES]
    assert begun[0] == max(begun)


def test_an_interrupted_run_is_not_written_and_ends_the_others(run, tmp_path):
    assert run(1, 1, "one", "stopped", "other") == ([], ["one"])
    assert [one.stem for one in tmp_path.glob("*.txt")] == ["one"]
