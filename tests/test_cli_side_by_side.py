"""Studies that run side by side, in copies of the process."""

import json
import os
import subprocess
import sys

import pytest

SCRIPT = """
import json, os, sys, time
from pathlib import Path
from types import SimpleNamespace
from needlefit.cli import execution
from needlefit.cli.execution import Execution, run_studies
from needlefit.cli.exit_codes import Invocation
from needlefit.studies.job import StatedStudy

def run(self, study, sample):
    assert self.invocation.jobs == int(sys.argv[2])
    time.sleep(0.5 if study.name == "first" else 0.0)  # it ends last
    self._print_note(study.name)
    return SimpleNamespace(name=study.name, interrupted=study.name == "stopped", process=os.getpid())

shown = []
Execution.run = run
Execution.write = lambda self, run: Path(f"{run.name}.txt").write_text(run.name)
execution.show_run = lambda asked, run, folder, named: shown.append(run.name)
asked = Invocation((), jobs=int(sys.argv[1]), quiet=True)
todo = [StatedStudy(name, SimpleNamespace()) for name in sys.argv[3:]]
try:
    done = run_studies(Execution(asked), todo)
except Exception as error:
    print(json.dumps([type(error).__name__, shown]))
else:
    print(json.dumps([[run.process == os.getpid() for run in done], shown, sorted(asked.noted)]))
"""
NAMES = ("first", "second", "third")


def run(folder, jobs, jobs_of_each, *names):
    words = [sys.executable, "-c", SCRIPT, str(jobs), str(jobs_of_each), *names]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def test_one_job_runs_one_after_another_in_this_process(tmp_path):
    assert run(tmp_path, 1, 1, *NAMES) == [[True] * 3, [*NAMES], [*NAMES]]


@pytest.mark.skipif(sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2, reason="no copies here")
def test_several_run_in_copies_of_it_and_are_shown_in_their_order(tmp_path):
    assert run(tmp_path, 2, 1, *NAMES) == [[False] * 3, [*NAMES], [*NAMES]]
    assert sorted(one.stem for one in tmp_path.glob("*.txt")) == sorted(NAMES)
    assert run(tmp_path, 9, 3, *NAMES)[0] == [False] * 3


def test_an_interrupted_run_is_not_written_and_ends_the_others(tmp_path):
    assert run(tmp_path, 1, 1, "one", "stopped", "other") == ["Exit", ["one"]]
    assert [one.stem for one in tmp_path.glob("*.txt")] == ["one"]
