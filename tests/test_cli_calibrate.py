"""`needlefit calibrate`: what it writes, how it ends, and that it goes on where it was stopped."""

import json
import subprocess
import sys
import time

import pandas as pd
import pytest
from made_again import assert_made_again
from test_cli import run

FILES = {
    "needlefit.json",
    *(
        "calibration.tex",
        "coverage.csv",
        "example.tex",
        "design.csv",
        "numbers.tex",
        "ranks.csv",
        "ranks.pdf",
    ),
    *("replicates.csv", "report.html", "report.pdf", "run.json", "timing.json"),
    "results.json.gz",
}


@pytest.fixture
def reports(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path / "reports"


COMMAND = (sys.executable, "-m", "needlefit", "calibrate", "study2", "--replicates", "2", "-q")


def calibrated(*words):
    """Run it as a user does: what other tests compile in this process is not in that one."""
    return subprocess.run((*COMMAND, *words), capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_an_interrupted_run_resumes_to_the_same_bytes(reports):
    whole = calibrated("--jobs", "1")
    assert whole.returncode == 5, whole.stderr  # too few
    folder = reports / "calibrate-study2"
    assert {path.name for path in folder.iterdir()} == FILES
    rows = pd.read_csv(folder / "replicates.csv")
    assert rows["replicate"].unique().tolist() == [0, 1] and set(rows["origin"]) == {"synthetic"}
    assert rows["rank"].between(0, 79).all() and not rows.duplicated(["replicate", "quantity"]).any()
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "timing.json"}
    assert_made_again(folder)
    running = subprocess.Popen((*COMMAND, "--jobs", "1"))  # so that one replicate is left to do
    kept, deadline = reports / "calibrate-study2.partial", time.monotonic() + 60
    while time.monotonic() < deadline and not any(path.stat().st_size for path in kept.glob("*.jsonl")):
        time.sleep(0.02)
    running.kill()
    running.wait()
    assert calibrated("--resume", "--jobs", "2").returncode == 5
    after = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "timing.json"}
    assert before == after and not kept.exists()


@pytest.mark.slow
def test_a_detected_control_exits_0_and_an_undetected_one_does_not(reports, capsys):
    """The prior as posterior: 15 truths are far likelier than its draws, too few tell nothing."""
    assert run("calibrate", "study2", "--control", "prior", "--replicates", "15", "-q", "--json") == 0
    output = json.loads(capsys.readouterr().out)
    assert output["not_calibrated"] == ["log_likelihood"] and output["draw_source"] == {"prior": 15}
    assert run("calibrate", "study2", "--control", "prior", "--replicates", "1", "-q") == 5  # too few
    assert "1 replicate" in capsys.readouterr().out
    assert json.loads((reports / "calibrate-study2-prior" / "run.json").read_text())["passes"] is False


def test_an_unknown_control_is_a_usage_error(reports, capsys):
    assert run("calibrate", "study2", "--control", "nothing") == 2
