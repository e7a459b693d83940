"""Corrections of scans: control points as written, moved as 3D Slicer moves them, and taken back."""

import json
import shlex
import tomllib
from dataclasses import replace
from pathlib import Path

import ct_cases as cases
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from pytest import approx
from reading_here import child_process_reader, read_here  # noqa: F401
from refusals import refusal
from scanner.write import write_volume
from test_cli import run
from test_cli_reconstruct import MARKERS, SAMPLE, VOLUME

from needlefit.cli.reconstruct import name_answer
from needlefit.errors import DataError
from needlefit.imaging.batch import reconstruct_needles
from needlefit.imaging.corrections import correct_scans, make_control_points, read_corrections
from needlefit.imaging.reconstruction import MarkerResult
from needlefit.imaging.scans import Corrections, Scan, make_scans, read_scans
from needlefit.reporting.scan_pages import write_refusal_page
from needlefit.schemas.scan_files import ScanFiles
from needlefit.studies.kinds.reconstruction.report import write_control_points

pytestmark = pytest.mark.usefixtures("read_here")

NEEDLE = np.array([-20.0, 30, 5]) + np.stack(
    [np.zeros(81), np.linspace(0, 2, 81) ** 2, np.arange(81.0)], axis=1
)
BALLS = np.array([[10.0, 20, 30], [-12, 8, 5], [40, 3, -9], [7, -31, 22]])
MARKERS_FOUND = MarkerResult(BALLS, np.full(4, 0.01), "volume")


@pytest.fixture
def file(tmp_path):
    write_control_points(make_control_points("s1", NEEDLE, NEEDLE[30], MARKERS_FOUND), tmp_path)
    return tmp_path / "s1.corrections.mrk.json"


def change(path, edit):
    """Let `edit` change the list of a file and its control points, by their labels."""
    whole = json.loads(path.read_text())
    (one,) = whole["markups"]
    edit(one, {point["label"]: point for point in one["controlPoints"]})
    path.write_text(json.dumps(whole))
    return path


def moved(path, *labels, by=(0.5, 0, 0)):
    """Move control points of a file; return the corrections in it."""

    def edit(_, points):
        for label in labels:
            points[label]["position"] = (np.array(points[label]["position"]) + by).tolist()

    return read_corrections(change(path, edit))["s1"]


def test_what_was_moved_or_added_is_a_correction_and_nothing_else(file):
    found = moved(file, "tip", by=(0, 0, -2))
    assert_allclose(found.tip, NEEDLE[-1] - [0, 0, 2], atol=1e-3)
    assert found.axis is found.entry is found.balls is None
    found = moved(file, "axis 2", "axis 3", "axis 7", "ball 1")
    assert found.axis.shape == (3, 3) and found.tip is not None
    assert_allclose(found.balls, BALLS + np.eye(4, 1) * [0.5, 0, 0], atol=1e-3)

    def add(one, _):
        one["controlPoints"] += [
            {"label": "Entry", "position": [1, 2, 3]},
            {"label": "ball", "position": [4, 5, 6]},
        ]
        one["controlPoints"] = [point for point in one["controlPoints"] if point["label"] != "entry"]
        one["name"] = "s1 corrections_1"  # as 3D Slicer calls a second list of a name

    found = read_corrections(change(file, add))["s1"]
    assert found.entry.tolist() == [1, 2, 3] and found.balls.shape == (5, 3)


def test_a_needle_whose_ends_lie_in_tissue_is_placed_as_its_refusal_offers(tmp_path):
    truth = cases.axis()[32:]
    whole = cases.scan(truth)
    write_volume(replace(whole, values=np.maximum(whole.values, -40.0)), tmp_path / "one.nrrd")
    scan = Scan("one", tmp_path / "one.nrrd", "gel")
    (failed,) = reconstruct_needles(scan, cases.RECIPE)
    assert "corrections" in failed.error.fix and {"axis 1", "tip"} <= set(failed.points.labels)
    write_refusal_page(failed, tmp_path / "quality" / "one.pdf")
    assert (tmp_path / "quality" / "one.pdf").stat().st_size > 5000
    assert len(failed.picture.views) == 2 and np.ptp(failed.picture.curve[:, 0]) > 25
    placed = Corrections(tip=truth[-1], entry=cases.ENTRY + np.array([0, 0, 8]))
    (one,) = reconstruct_needles(replace(scan, corrections={"one": placed}), cases.RECIPE)
    assert one.depth == approx(20.0, abs=0.3)
    placed = replace(placed, axis=truth[[4, 20, 40]])
    (one,) = reconstruct_needles(replace(scan, corrections={"one": placed}), cases.RECIPE)
    assert one.depth == approx(20.0, abs=0.3) and "axis" in one.warnings[0]


@pytest.mark.parametrize(
    ("edit", "word"),
    [
        (lambda one, points: points["ball 1"].update(label="marker"), "`marker`"),
        (
            lambda one, points: [
                points[name].update(label=label)
                for name, label in {"tip": "12", "axis 1": "F-1", "ball 1": "ball 1 2"}.items()
            ],
            "`F-1`, `12`, `ball 1 2`",
        ),
        (lambda one, points: one.update(name="F"), "`F`"),
        (lambda one, points: one.update(type="Curve"), "Curve"),
        (
            lambda one, points: [
                points[name].update(label="tip", description="") for name in ("ball 1", "ball 2")
            ],
            "tip",
        ),
    ],
)
def test_lists_that_are_no_corrections_are_refused(file, edit, word):
    error = refusal(DataError, "", read_corrections, change(file, edit))
    assert word in error.what and error.where.startswith(str(file)) and error.fix


def test_corrections_belong_to_a_scan_that_can_take_them(file):
    (other,) = make_scans([VOLUME], ScanFiles(markers=MARKERS))
    (stage,) = read_scans(SAMPLE / "scans.csv")
    scan = replace(other, id="s1")

    def refused(scan, *files):
        return refusal(DataError, "", correct_scans, [scan], files).what

    assert "was moved" in refused(scan, file)
    moved(file, "ball 1")
    (corrected,) = correct_scans([scan], [file])
    assert corrected.corrections["s1"].balls.shape == (4, 3) and not scan.corrections
    assert "s1" in refused(other, file)
    assert "second time" in refused(scan, file, file)
    assert "known places" in refused(replace(scan, markers=None), file)
    moved(file, "entry")
    assert "stage" in refused(replace(stage, id="s1"), file)


def test_a_plate_on_the_tissue_is_asked_about_and_what_a_person_answers_is_taken(
    tmp_path, monkeypatch, capsys
):
    """A plate of 14 mm on the gel, 28 mm before the tip: confirmed as tissue, or stated as a guide."""
    monkeypatch.chdir(tmp_path)
    grid = cases.grid(size=(48, 48, 121), origin=np.array([0.0, 0.0, -5.0]))
    write_volume(cases.scan(cases.axis(), layers_hu=(360.0, 40.0), grid=grid), Path("plate.nrrd"))
    words = ["reconstruct", "plate.nrrd", "-q", "--out"]
    assert run(*words, "asked") == 3
    lines = capsys.readouterr().err.splitlines()
    (command,) = (
        line[line.index("needlefit reconstruct") :] for line in lines if line.endswith("--confirm entry=1")
    )
    (points,) = json.loads(Path("asked.refused/slicer/plate.mrk.json").read_text())["markups"]
    places = {point["label"]: np.array(point["position"]) for point in points["controlPoints"]}
    assert places.keys() == {"tip", "entry 1", "entry 2", "guide 1 begins", "guide 1 ends"}
    assert_allclose(places["entry 2"], cases.ENTRY, atol=0.1)
    lengths = [np.linalg.norm(places["tip"] - places[f"guide 1 {end}"]) for end in ("begins", "ends")]
    assert lengths == approx([28.0, 14.0], abs=0.6)
    assert run(*shlex.split(command)[1:]) == 0  # as it is printed
    offered = pd.read_csv("asked/reconstruction.csv").iloc[0]
    assert offered["depth_mm"] == approx(14.0, abs=0.6) and "confirmed" in offered["warnings"]
    confirmed = tomllib.loads(Path("asked/dataset.toml").read_text())["import"]["confirmed"]
    assert [*confirmed] == ["entry of plate"]
    lists = json.loads(Path("asked/slicer/plate.mrk.json").read_text())["markups"]
    (guide,) = (one["controlPoints"] for one in lists if "guide" in one["name"])
    assert guide[0]["position"] == approx(places["entry 2"], abs=0.1) and guide[1]["label"] == "guide ends"
    assert run(*words, "before", "--confirm", "plate:entry=2") == 0
    assert pd.read_csv("before/reconstruction.csv").iloc[0]["depth_mm"] == approx(28.0, abs=0.2)
    capsys.readouterr()
    assert run(*words, "none", "--confirm", "plate:entry=10") == 3
    printed = capsys.readouterr().err
    assert all(part in printed for part in ("--confirm: ", " 10:", " 1 to 2\n"))
    assert "--confirm plate:entry=1\n" in printed  # in place of the other
    # 6 mm of it as a guide that looks as the tissue does: what is passed is cut there
    Path("thin.toml").write_text("schema = 2\n[guide]\nthickness_mm = 6.0\n")
    assert run(*words, "thin", "--recipe", "thin.toml", "--confirm", "entry=2") == 0
    passed = pd.read_csv("thin/passed.csv").iloc[-3:]
    assert [*passed["part"]] == ["guide", "tissue", "tissue"]
    assert [*passed["begin_mm"]] == approx([-6.0, 0.0, 8.0], abs=0.1)
    assert [*passed["end_mm"]] == approx([0.0, 8.0, 22.0], abs=0.1)
    Path("tissue.toml").write_text("schema = 2\n[guide]\nthickness_mm = 0.0\n")
    capsys.readouterr()
    assert run(*words, "unasked", "--recipe", "tissue.toml", "--confirm", "entry=1") == 3
    assert "--confirm for plate" in capsys.readouterr().err and not Path("unasked").exists()


def test_an_answer_names_its_scan_or_its_needle(capsys):
    scan = Scan("gel", Path("gel.nrrd"), "gel")
    assert [name_answer(scan, count) for count in (1, 2)] == ["entry=1", "gel:entry=1"]
    assert name_answer(replace(scan, id="gel-2"), 2) == "gel-2:entry=1"
    for wrong in ("axis", "gel:entry=1", "entry=0", "entry=one", "sample:entry=3"):
        assert run("reconstruct", VOLUME, "--confirm", "entry=2", "--confirm", wrong) == 2
        printed = capsys.readouterr().err
        assert wrong in printed and "--confirm entry=1" in printed
