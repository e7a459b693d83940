"""`needlefit simulate --recording`: what was steered by hand, carried out again; and the files it writes."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from test_cli import run
from test_viewer_recording import WANDERING, recorded

from needlefit.reporting.figures import animation


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    return path, recorded(path)


def answer(capsys, *words):
    assert run("simulate", *map(str, words), "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_a_recording_ends_where_it_ended_bit_for_bit(log, capsys):
    path, found = log
    output = answer(capsys, "--recording", path)
    assert output["tip_lateral_mm"] == found[-1][-1]
    assert output["replayed"] == {"steps": len(WANDERING), "tip_offset_mm": 0.0}
    assert (output["depth_mm"], output["converged"], len(output["steps"])) == (5.0, True, 1)
    assert output["boundaries_mm"] == [20, 28, 45]


@pytest.mark.parametrize(("step", "depth"), [(0, 0.0), (1, 12.34567), (5, 25.1), (8, 30.0), (15, 5.0)])
def test_a_recording_can_be_stopped_after_a_step(log, step, depth, capsys):
    path, found = log
    output = answer(capsys, "--recording", path, "--step", step)
    assert output["depth_mm"] == depth
    assert output["tip_lateral_mm"] == found[step][-1]


def test_a_recording_is_printed_as_a_scene_is(log, capsys):
    assert run("simulate", "--recording", str(log[0]), "--step", "8") == 0
    printed = capsys.readouterr().out
    deflection, depth = map(float, re.findall(r"([\d.]+) mm", printed.splitlines()[0])[:2])
    assert (deflection, depth) == (pytest.approx(log[1][8][-1], abs=5.1e-4), 30)
    assert "Study 2" in printed


def test_a_tip_that_differs_from_the_recording_is_reported(log, capsys):
    path, found = log
    tip = repr(float(found[1][-1]))
    path.write_text(path.read_text().replace(tip, repr(float(found[1][-1]) + 1e-3), 1))
    assert answer(capsys, "--recording", path)["replayed"]["tip_offset_mm"] == pytest.approx(1e-3, rel=1e-6)
    run("simulate", "--recording", str(path))
    assert " 0.001 mm " in capsys.readouterr().out


@pytest.mark.sweep
def test_files_of_a_recording_and_of_a_scene(log, tmp_path, capsys, monkeypatch):
    for name, value in (("MAX_FRAMES", 4), ("FINAL_FRAMES", 2), ("DOTS_PER_INCH", 15)):
        monkeypatch.setattr(animation, name, value)
    files = {"csv": "a.csv", "slicer": "a.mrk.json", "plot": "a.svg", "animation": "a.gif"}
    options = [word for option, file in files.items() for word in (f"--{option}", tmp_path / file)]
    for source in (["--recording", log[0], "--step", 8], ["study2", "--depth", 20]):
        assert run("simulate", *map(str, [*source, *options])) == 0
        captured = capsys.readouterr()
        tip = float(re.search(r"[-−]?[\d.]+", captured.out)[0])
        assert all(f": {tmp_path / file}" in captured.err for file in files.values())
        table = pd.read_csv(tmp_path / "a.csv")
        assert table["y_mm"].iloc[-1] == pytest.approx(tip, abs=5.1e-4)
        (curve,) = json.loads((tmp_path / "a.mrk.json").read_text())["markups"]
        np.testing.assert_allclose(curve["controlPoints"][-1]["position"][1], tip, atol=5.1e-4)
        assert (tmp_path / "a.svg").read_bytes().startswith(b"<?xml")
        assert (tmp_path / "a.gif").read_bytes().startswith(b"GIF89a")
        for file in files.values():
            (tmp_path / file).unlink()


def test_an_unconverged_needle_is_not_written(tmp_path, capsys):
    file = tmp_path / "a.csv"
    assert run("simulate", "study2", "--set", "bevel.offset_mm=60", "--csv", str(file)) == 5
    assert not file.exists() and "written" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["study2", "--recording", "LOG"], "leave out SCENE"),
        (["--recording", "LOG", "--depth", "20"], "leave out SCENE"),
        (["--recording", "LOG", "--set", "bevel.side=-1"], "leave out SCENE"),
        (["--recording", "LOG", "--step", "16"], "has 15 steps"),
        (["--recording", "LOG", "--step", "-1"], "greater than or equal to 0"),
        (["study2", "--step", "3"], "needs --recording"),
        ([], "give a SCENE"),
    ],
)
def test_contradicting_options_are_a_usage_error(log, words, fault, capsys):
    assert run("simulate", *(str(log[0]) if word == "LOG" else word for word in words)) == 2
    assert fault in " ".join(capsys.readouterr().err.replace("│", " ").split())


@pytest.mark.parametrize(
    ("old", "new", "fault", "expected"),
    [
        ("bevel_side", "bevel_sid", "`bevel_sid`", "depth_mm"),
        ("12.34567", "500.0", "step 1 ", "depth"),
        ("5,1.2500,", "9,1.2500,", "step 9", "step 5"),
    ],
)
def test_a_fault_of_a_recording_is_reported_with_its_line(log, old, new, fault, expected, capsys):
    path = log[0]
    lines = path.read_text().splitlines(keepends=True)
    number = next(n for n, line in enumerate(lines) if old in line and not line.startswith("#"))
    lines[number] = lines[number].replace(old, new)
    path.write_text("".join(lines))
    assert run("simulate", "--recording", str(path)) == 3
    printed = capsys.readouterr().err
    found, _, rest = printed.partition("expected: ")
    assert f"{path}, line {number + 1}: " in found and fault in found and expected in rest


def test_a_file_that_is_no_recording_is_refused(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("x,y\n1,2\n")
    assert run("simulate", "--recording", str(tmp_path / "a.csv")) == 3
    assert "is no recording" in capsys.readouterr().err
    assert run("simulate", "--recording", str(tmp_path / "none.csv")) == 3
