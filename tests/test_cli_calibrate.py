"""`needlefit calibrate`: what it writes, how it ends, and that it goes on where it was stopped."""

import json

import pytest
from test_cli import run


@pytest.fixture
def reports(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path / "reports"


@pytest.mark.sweep
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
