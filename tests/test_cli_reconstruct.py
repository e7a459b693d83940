"""`needlefit reconstruct` as its users meet it: the sample scan, whole and spoiled in every way."""

import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_again import read_files
from pytest import approx
from reading_here import child_process_reader, read_here  # noqa: F401
from scanner.write import write_volume
from test_cli import run

from needlefit.datasets.read import check
from needlefit.datasets.read import read as read_dataset
from needlefit.imaging.volume_files import read_volume
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.scene import SceneRecord

SAMPLE = shipped_folder() / "data" / "sample_scan"
VOLUME, MARKERS = SAMPLE / "volumes" / "sample.nrrd", SAMPLE / "markers" / "sample.csv"


pytestmark = pytest.mark.usefixtures("read_here")


def test_a_scan_becomes_a_checked_dataset(world):
    done = world.find("reconstruction")
    assert check(done) == []
    dataset = read_dataset(done)
    (insertion,) = dataset.insertions
    assert dataset.origin == "synthetic"  # as the table of scans says
    assert insertion.depth == approx(25.0, abs=0.3)
    assert insertion.boundaries == approx([19.0], abs=0.3)
    assert insertion.sd is not None and (insertion.sd > 0).all() and insertion.sd.max() < 0.1
    assert insertion.pose_source == "stage"
    names = ("reconstruction", "markers", "crossings")
    scans, markers, crossings = (pd.read_csv(done / f"{name}.csv") for name in names)
    assert len(scans) == 1 and scans.loc[0, "markers_paired"] == len(markers) >= 4
    gaps = np.linalg.norm(markers[[f"residual_{axis}_mm" for axis in "xyz"]], axis=1)
    assert markers["residual_mm"].to_numpy() == approx(gaps, rel=1e-4)
    assert scans.loc[0, "fre_mm"] == approx(np.sqrt(np.mean(gaps**2)), rel=1e-4)
    assert crossings[["out_of", "into"]].to_numpy().tolist() == [[1, 2]]


def test_a_scan_alone_gives_its_tip_and_a_scene(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("reconstruct", VOLUME, "-q") == 0
    printed = capsys.readouterr().out
    row = pd.read_csv("sample-dataset/reconstruction.csv").iloc[0]
    (insertion,) = read_dataset(Path("sample-dataset")).insertions
    tip = row[["tip_l_mm", "tip_p_mm", "tip_s_mm"]].to_numpy(dtype=float)
    assert insertion.centerline[-1] == approx(tip, abs=1e-3)  # without markers the world is the scan
    numbers = np.array(re.findall(r"\d+\.\d\d", printed), dtype=float)
    for value in (*tip, row["depth_mm"], 1.27):
        assert np.abs(numbers - abs(value)).min() < 0.0051  # 136.825 is printed as 136.82 or 136.83
    assert np.isnan(row["markers_paired"])
    scene = load(Path("sample-dataset/scenes/sample.toml"), SceneRecord)
    assert scene.depth_mm == approx(row["depth_mm"], abs=1e-3)
    (proposed,) = (line.partition("needlefit ")[2] for line in printed.splitlines() if "predict" in line)
    assert run(*shlex.split(proposed), "-q") == 0  # as it is printed, from this folder


@pytest.mark.sweep
def test_one_failure_loses_nothing_and_results_of_a_second_run_equal_those_of_another(tmp_path, capsys):
    """Of two scans one is truncated at first."""
    cut, out = tmp_path / "truncated.nrrd", tmp_path / "out"
    cut.write_bytes(VOLUME.read_bytes()[:40_000])
    shutil.copy(VOLUME, tmp_path / "whole.nrrd")
    words = ("reconstruct", cut, tmp_path / "whole.nrrd", "--jobs", "1", "-q", "--out")
    assert run(*words, out) == 3
    printed = capsys.readouterr().err
    assert "1 of 2 needles" in printed and "fix" in printed
    assert [one.id for one in read_dataset(out).insertions] == ["whole"]
    kept = out.with_name("out.partial")
    assert any(path.suffix == ".jsonl" for path in kept.iterdir())
    shutil.copy(VOLUME, cut)
    assert run(*words, out) == 0 and not kept.exists()
    assert [one.id for one in read_dataset(out).insertions] == ["truncated", "whole"]
    again = out.with_name("again") / "out"
    capsys.readouterr()
    assert run(*words, again, "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["failed"] == [] and [row["entry_pose_from"] for row in printed["scans"]] == 2 * ["shaft"]
    assert read_files(out) == read_files(again)


def table(folder, **changes):
    """The sample's table with some cells changed, its files named from where they are."""
    row = pd.read_csv(SAMPLE / "scans.csv", dtype=str).iloc[0].to_dict()
    row |= {"scan": str(VOLUME), "markers": str(MARKERS)}
    row["surfaces"] = ";".join(f"{SAMPLE / one}" for one in row["surfaces"].split(";"))
    path = folder / "scans.csv"
    pd.DataFrame([row | changes]).to_csv(path, index=False)
    return path


# What may be wrong, one thing at a time: a function that makes the words of the command in a folder.


def spoiled(folder, change):
    """Write the sample volume with its values changed."""
    volume = read_volume(VOLUME)
    write_volume(replace(volume, values=change(volume.values)), folder / "spoiled.nrrd")
    return folder / "spoiled.nrrd"


def no_metal(folder):
    return [spoiled(folder, lambda values: np.minimum(values, 200)), "--markers", MARKERS]


def two_needles(folder):
    return [spoiled(folder, lambda values: np.maximum(values, np.roll(values, 18, np.argmin(values.shape))))]


def test_every_needle_of_a_scan_is_an_insertion_and_the_printed_commands_follow(tmp_path, capsys) -> None:
    (path,) = two_needles(tmp_path)
    assert run("reconstruct", path, "--all", "--out", tmp_path / "both", "-q") == 0
    *_, study, predict = (
        shlex.split(line.partition("needlefit ")[2]) for line in capsys.readouterr().err.splitlines()
    )
    assert study[0] == "validate" and predict[:3] == ["predict", study[1], "--scene"]
    assert run("check", study[1]) == 0 and run("simulate", predict[3]) == 0
    assert run("tune", tmp_path / "both") == 3 and study[1] in capsys.readouterr().err
    assert run("report", tmp_path / "both") == 0
    assert str(tmp_path / "both/scenes") in capsys.readouterr().out
    found = read_dataset(tmp_path / "both").insertions
    assert [one.id for one in found] == ["spoiled-1", "spoiled-2"]
    lists = json.loads((tmp_path / "both/slicer/spoiled-2.corrections.mrk.json").read_text())
    points = {point["label"]: point for point in lists["markups"][0]["controlPoints"]}
    points["tip"]["position"] = points["axis 8"]["position"]
    (tmp_path / "moved.mrk.json").write_text(json.dumps(lists))
    moved = ("--corrections", tmp_path / "moved.mrk.json")
    assert run("reconstruct", path, "--all", "--out", tmp_path / "moved", "-q", *moved) == 0
    before, after = (pd.read_csv(tmp_path / name / "reconstruction.csv") for name in ("both", "moved"))
    assert before["tip_l_mm"].is_monotonic_increasing
    assert (before["depth_mm"] - after["depth_mm"]).tolist() == approx([0, 2.5], abs=0.5)
    capsys.readouterr()
    for answer, named in {
        "entry=1": "spoiled-1:entry=1",
        "spoiled-2:entry=1": "--confirm for spoiled-2",
    }.items():
        assert run("reconstruct", path, "--all", "--out", tmp_path / "asked", "-q", "--confirm", answer) == 3
        assert named in capsys.readouterr().err
    assert [*pd.read_csv(tmp_path / "asked/reconstruction.csv")["id"]] == ["spoiled-1"]


def mirrored_markers(folder):
    known = pd.read_csv(MARKERS)
    known.assign(y_mm=-known["y_mm"]).to_csv(folder / "known.csv", index=False)
    return [VOLUME, "--markers", folder / "known.csv"]


def short_needle(folder):
    (folder / "short.toml").write_text("schema = 1\n[needle]\nlength_mm = 20.0\n")
    return [VOLUME, "--recipe", folder / "short.toml"]


def changed(**cells):
    return lambda folder: [table(folder, **cells)]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (no_metal, "metal"),
        (two_needles, "2 needles"),
        (mirrored_markers, "mirror"),
        pytest.param(short_needle, r"sample\.nrrd: gives no insertion.*20 mm long", marks=pytest.mark.sweep),
        (changed(entry_y_mm="-2.5"), "outside the tissue"),  # the sign of RAS: with its row of the dataset
        (changed(entry_dx="-1.0"), "does not pass the entry"),
        (changed(layers="3", layers_alternative="3"), "3 layers|3 were counted"),
    ],
)
def test_faulty_input_is_reported_with_a_fix_and_nothing_is_written(spoil, words, tmp_path, capsys):
    arguments = spoil(tmp_path)
    before = read_files(tmp_path)
    capsys.readouterr()
    assert run("reconstruct", *arguments, "--out", tmp_path / "out", "-q") == 3
    printed = capsys.readouterr().err

    assert re.search(words, printed), printed
    assert "fix:" in printed and "unexpected" not in printed
    # the id, and not again the file of its name
    assert not re.search(r"needlefit: (\w+): \S*/\1[.:]", printed), printed
    after = read_files(tmp_path)
    pages = {name for name in after if name.startswith("out.refused/")}
    assert {name: after[name] for name in after.keys() - pages} == before
    assert "out.refused/refused.csv" in pages
