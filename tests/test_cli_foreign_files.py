"""Every command that writes a folder, with files of the user in it: all of them are there afterwards."""

import dataclasses
import shutil
from pathlib import Path

import pytest
from reporting_results import print_nothing, study
from test_cli import run
from test_datasets import write_mine
from test_viewer_recording import recorded
from world import build_project

from needlefit.mechanics import scene
from needlefit.project.folders import replace_folder, require_output_files, write_manifest
from needlefit.project.locate import find_file, shipped_folder
from needlefit.reporting.table_files import write_json
from needlefit.studies import load as load  # bound before a test takes away what it imports
from needlefit.studies.run import store_run

SCANS = str(shipped_folder() / "data" / "sample_scan" / "scans.csv")
FOREIGN = ("notes.md", "errors_mine.csv", "slicer/mine.mrk.json", "quality/mine.pdf", "sub/a/b.csv")
EMPTY = "to be filled"
"""A folder of the user's that holds nothing yet."""

CASES = {
    "tune held_out --out out -q": "held_out-tune held_out-tune.partial",
    "validate held_out --reference --out out -q": "held_out held_out.partial reference/held_out",
    "tune held_out --design --out out -q": "held_out-design held_out-design.partial",
    "predict held_out --scene ahead --out out -q": "predict-held_out-ahead",
    "report ./out/run --out out/again": "again",
    f"reconstruct {SCANS} --out out/rr -q": "rr",
    "import curves.csv --out out/found --yes": "found",
    "new project out/project": "project",
}
"""Command lines, and the folders in `out` that they replace or remove."""
REFUSED = [(line, f"out/{name}") for line, folders in CASES.items() for name in folders.split()]


def everything(folder):
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in sorted(folder.rglob("*"))}


def plant(folder):
    for name in FOREIGN:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(f"mine: {folder / name}\n".encode())
    (folder / EMPTY).mkdir(exist_ok=True)
    return {str(folder / EMPTY): b""} | {str(folder / name): (folder / name).read_bytes() for name in FOREIGN}


@pytest.fixture
def project(tmp_path, monkeypatch):
    folder = tmp_path / "project"
    build_project(folder)
    monkeypatch.chdir(folder)
    recorded(folder / "log.csv")
    points = "".join(f"{x},{4e-4 * x**2},0\n" for x in range(40))
    (folder / "curves.csv").write_text(f"x_mm,y_mm,z_mm\n{points}")
    (folder / "out").mkdir()
    return folder


@pytest.fixture
def stubs(monkeypatch):
    """Another run stands for the fitting."""
    monkeypatch.setattr(
        "needlefit.studies.kinds.cross_validation.run.run",
        lambda name, record, settings: dataclasses.replace(study(1), name=name, record=record),
    )
    print_nothing(monkeypatch)  # seconds, and other tests' business


def leave_run(folder):
    """Leave what the commands read that are about a run."""
    made = dataclasses.replace(study(1), name=folder.name)
    folder.mkdir(parents=True)
    store_run(made, folder)
    write_json(folder / "run.json", made.run_json)
    write_manifest(folder)


@pytest.mark.parametrize(
    ("command", "place", "whose"),
    [*((*one, "the user's") for one in REFUSED), *((*one, "a result") for one in REFUSED[::4])],
)
def test_folders_with_foreign_files_are_refused_before_the_run(command, place, whose, project, stubs, capsys):
    """The folder is the user's own, or one that needlefit wrote and the user added to."""
    folder = project / place
    if "./out/run" in command:
        leave_run(project / "out/run")
    plant(folder)
    if whose == "a result":
        shutil.rmtree(folder)
        (folder / "slicer").mkdir(parents=True)
        (folder / "slicer" / "a.mrk.json").touch()
        write_manifest(folder)
        plant(folder)
    before = everything(project)
    assert run(command) == 3
    assert everything(project) == before
    printed = capsys.readouterr().err
    assert any(name in printed for name in FOREIGN) or "exists already" in printed
    assert str(folder) in printed or place in printed


# --- names, folders and inputs are checked before the work --------------------


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "mine.toml"
    shutil.copy(find_file("scene", "study2"), path)
    return path


@pytest.mark.parametrize("option", ["--csv", "--plot", "--slicer"])
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
    assert run("simulate", own, option, out) == 3
    assert own.read_bytes() == before


def test_a_recording_and_the_dataset_that_it_is_of_are_not_replaced(tmp_path, monkeypatch):
    log = tmp_path / "log.csv"
    recorded(log)
    log.write_text(log.read_text().replace('target = "study2"', 'target = "./data/example1"'))
    monkeypatch.chdir(tmp_path)
    write_mine(tmp_path / "data")
    for path in (log, tmp_path / "data/insertions.csv", tmp_path / "data/centerlines/example1.csv"):
        before = path.read_bytes()
        assert run("simulate --recording log.csv --csv", path) == 3
        assert path.read_bytes() == before
    assert run("simulate --recording log.csv --csv data/new.csv") == 0


def test_colliding_outputs_are_refused_and_an_old_one_is_replaced(own, tmp_path):
    out = str(tmp_path / "out.pdf")
    assert run("simulate", own, "--plot", out, "--csv", out) == 3
    assert run("simulate", own, "--plot", tmp_path) == 3
    for _ in range(2):
        assert run("simulate", own, "--csv", tmp_path / "out.csv") == 0
    require_output_files({"--csv": Path("/dev/null")}, [own])


def test_a_dataset_does_not_overwrite_its_scans(tmp_path, capsys):
    """A folder of ours carries a stamp: but for its scans being inputs it could be replaced."""
    with replace_folder(tmp_path / "ct") as fresh:
        shutil.copytree(shipped_folder() / "data/sample_scan", fresh, dirs_exist_ok=True)
        (fresh / "needlefit.json").unlink(missing_ok=True)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "ct").rglob("*")}
    assert run("reconstruct", tmp_path / "ct/scans.csv", "--out", tmp_path / "ct", "-q") == 3
    assert "scans.csv" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "ct").rglob("*")} == before
