"""A small study through the whole program: same bytes for any jobs, after Ctrl-C and resume; a tuned fit."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from reporting_results import skip_figures

from needlefit.cli import main
from needlefit.project.locate import find_file

COMMAND = (sys.executable, "-m", "needlefit")
STUDY = """\
schema = 1
title = "Small"
paper_study = 2
dataset = "twin"
medium = "phantom2"
recipe = "small"
paper_parameters = "study2"
tune = { medium = "phantom2", layers = [2] }
validate = [{ medium = "phantom2", layers = [1] }]
"""


def needlefit(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run((*COMMAND, *words), cwd=folder, capture_output=True, text=True, check=False)


def here(*words: str) -> int:
    """Run a command in this process, where its modules are loaded already; return its exit code."""
    with pytest.raises(SystemExit) as leaving:
        main(list(words))
    return int(leaving.value.code or 0)


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file but the one that may differ."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != "timing.json"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    (folder / "studies").mkdir()
    (folder / "studies/small.toml").write_text(STUDY, encoding="utf-8")
    recipe = find_file("recipe", "quick").read_text(encoding="utf-8")
    recipe += "\n[likelihood]\nbevel_spread = 0.0\n"  # half the time
    (folder / "configs/recipes").mkdir(parents=True)
    (folder / "configs/recipes/small.toml").write_text(recipe, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def once(project: Path) -> dict[str, bytes]:
    done = needlefit("validate", "small", "--jobs", "1", "--json", folder=project)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["validation"]
    assert {(row["study"], row["layers"], row["origin"]) for row in rows} == {(2, 1, "synthetic")}
    (error,) = (
        row["value"]
        for row in rows
        if (row["method"], row["boundaries"], row["metric"]) == ("fitted", "measured", "te_mm")
    )
    assert 0 < error < 3
    return contents(project / "reports/small")


def test_a_result_folder_records_how_it_was_made(project, once):
    run = json.loads(once["run.json"])
    assert {"validation.csv", "parameters.csv", "validation.tex", "report.pdf"} <= once.keys()
    assert str(project) not in json.dumps(run)
    assert not (project / "reports/small.partial").exists()


@pytest.mark.slow
def test_ctrl_c_resume_and_other_jobs_change_no_byte(project, once):
    words = ("validate", "small", "--jobs", "2", "--out", "again")
    running = subprocess.Popen(
        (*COMMAND, *words), cwd=project, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while running.poll() is None and time.monotonic() < deadline:
        if any(path.stat().st_size for path in (project / "again").glob("*.partial/*.jsonl")):
            break
        time.sleep(0.005)
    running.send_signal(signal.SIGINT)
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 130, errors
    assert f"needlefit {' '.join(words)} --resume" in errors
    assert not (project / "again/small").exists()
    resumed = needlefit(*words, "--resume", folder=project)
    assert resumed.returncode == 0, resumed.stderr
    assert contents(project / "again/small") == once


@pytest.mark.slow
def test_a_report_is_rebuilt_from_stored_results(project, once, monkeypatch, capsys):
    monkeypatch.chdir(project)
    again = project / "reports/small-again"
    shutil.copytree(project / "reports/small", again)
    (again / "errors.csv").unlink()
    (again / "report.pdf").write_bytes(b"somebody's")
    assert here("report", "small", "--out", str(again)) == 3
    assert "report.pdf" in capsys.readouterr().err
    assert (again / "report.pdf").read_bytes() == b"somebody's"
    (again / "report.pdf").unlink()
    assert here("report", "small", "--out", str(again)) == 0
    assert contents(again) == once


@pytest.mark.slow
def test_tune_prints_the_paper_s_parameters_beside_the_fit(project, monkeypatch, capsys):
    monkeypatch.chdir(project)
    skip_figures(monkeypatch)  # takes longest
    assert here("tune", "small") == 0
    assert (project / "reports/small-tune/run.json").is_file()
    out = capsys.readouterr().out
    assert "Paper" in out and "not determined" in out
