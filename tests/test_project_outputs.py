"""Where results are written is checked before the work: names, folders, inputs that would be lost."""

import os
import shutil
from pathlib import Path

import pytest
from test_cli import run
from test_viewer_recording import recorded

from needlefit.errors import ConfigError
from needlefit.imaging import batch
from needlefit.mechanics import scene
from needlefit.project.folders import require_output_files, require_writable
from needlefit.project.init import copy_project
from needlefit.project.locate import find_file, shipped_folder
from needlefit.studies import targets as targets  # bound before a test takes away what it imports
from needlefit.verification import run as verification


@pytest.mark.parametrize(
    "name",
    ["n" * 250, "n" * 232, "é" * 120, f"{'d' * 256}/x", "/".join(["deep" * 50] * 25), "a\0b", "/"],
)
def test_an_unwritable_output_path_is_refused(name, tmp_path):
    with pytest.raises(ConfigError):
        require_writable(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_valid_output_names_pass(tmp_path):
    longest = os.pathconf(tmp_path, "PC_NAME_MAX") - 24
    for place in ("new", "new/newer/newest", "n" * longest, "é" * (longest // 2)):
        require_writable(tmp_path / place)


@pytest.mark.parametrize(
    "words",
    [
        ("verify", "--out", "o" * 300, "-q"),
        ("tune", "study3", "--out", "o" * 300, "-q"),
        ("validate", "study3", "--reference", "--out", "o" * 300, "-q"),
        ("calibrate", "study3", "--out", "o" * 300, "-q"),
        ("identify", "study3", "--out", "o" * 300, "-q"),
        ("predict", "study3", "--scene", "study2", "--out", "o" * 300, "-q"),
        ("view", "study2", "--no-browser", "--out", "o" * 300),
        ("reconstruct", str(shipped_folder() / "data/sample_scan/scans.csv"), "--out", "o" * 240, "-q"),
        ("twin", "build", "--out", "o" * 300, "-q"),
        ("twin", "ct", "--out", "o" * 300, "-q"),
        ("init", "o" * 300),
        ("new", "dataset", "o" * 300),
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_every_command_refuses_a_name_that_is_too_long_before_it_works(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for place in (
        "needlefit.studies.kinds.cross_validation.run.run",
        "needlefit.studies.job.prepare",
        "needlefit.cli.view._trials",
        "needlefit.synthetic.build.build_dataset",
        "needlefit.synthetic.scans.write_scans",
    ):
        monkeypatch.setattr(place, None)
    monkeypatch.setattr(verification, "find_checks", None)
    monkeypatch.setattr(batch, "reconstruct_all", None)
    assert run(*words) == 3
    assert "unexpected" not in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    shutil.copy(find_file("scene", "study2"), path)
    return path


@pytest.mark.parametrize("option", ["--csv", "--plot", "--slicer", "--animation"])
@pytest.mark.parametrize("how", ["same", "link", "hard link", "relative"])
def test_a_scene_is_not_replaced_by_what_is_written_of_it(option, how, own, monkeypatch):
    monkeypatch.setattr(scene, "simulate_scene", None)  # refused before it is simulated
    monkeypatch.chdir(own.parent)
    before, out = own.read_bytes(), own.with_name("out.png")
    if how == "link":
        out.symlink_to(own)
    elif how == "hard link":
        out.hardlink_to(own)
    else:
        out = own if how == "same" else Path("mine.toml")
    assert run("simulate", str(own), option, str(out)) == 3
    assert own.read_bytes() == before


def test_a_recording_and_the_dataset_that_it_is_of_are_not_replaced(tmp_path, monkeypatch):
    log = tmp_path / "log.csv"
    recorded(log)
    log.write_text(log.read_text().replace('target = "study2"', 'target = "./data/example1"'))
    monkeypatch.chdir(tmp_path)
    assert run("new", "dataset", "data") == 0
    for path in (log, tmp_path / "data/insertions.csv", tmp_path / "data/centerlines/example1.csv"):
        before = path.read_bytes()
        assert run("simulate", "--recording", "log.csv", "--csv", str(path)) == 3
        assert path.read_bytes() == before
    assert run("simulate", "--recording", "log.csv", "--csv", "data/new.csv") == 0


def test_colliding_outputs_are_refused_and_an_old_one_is_replaced(own, tmp_path, capsys):
    out = str(tmp_path / "out.svg")
    assert run("simulate", str(own), "--plot", out, "--csv", out) == 3
    assert run("simulate", str(own), "--plot", str(tmp_path)) == 3
    for _ in range(2):
        assert run("simulate", str(own), "--csv", str(tmp_path / "out.csv")) == 0
    require_output_files({"--csv": Path("/dev/null")}, [own])


def test_a_dataset_does_not_overwrite_its_scans(tmp_path, capsys):
    """The folder of `twin ct` carries our stamp: but for its scans being inputs it could be replaced."""
    from needlefit.project.folders import replace_folder

    with replace_folder(tmp_path / "ct") as fresh:
        shutil.copytree(shipped_folder() / "data/sample_scan", fresh, dirs_exist_ok=True)
        (fresh / "needlefit.json").unlink(missing_ok=True)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "ct").rglob("*")}
    assert run("reconstruct", str(tmp_path / "ct/scans.csv"), "--out", str(tmp_path / "ct"), "-q") == 3
    assert "scans.csv" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "ct").rglob("*")} == before


def test_a_project_is_begun_in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes/thesis.docx").touch()
    for folder in (Path("/"), tmp_path, tmp_path / "notes", tmp_path / "notes/thesis.docx"):
        with pytest.raises(ConfigError):
            copy_project(folder)
    assert [path.name for path in (tmp_path / "notes").iterdir()] == ["thesis.docx"]
    (tmp_path / "new/.git").mkdir(parents=True)
    assert len(copy_project(tmp_path / "new")) == 3
