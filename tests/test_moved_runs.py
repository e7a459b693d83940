"""A run whose folder was moved alone: it holds its data, or its dataset is looked for and named."""

import json
import shutil
from types import SimpleNamespace

import pytest
from light_runs import draw_blank
from refusals import refusal
from test_cli import run
from world import copy_project

import needlefit
from needlefit.datasets.sources import DatasetFiles
from needlefit.errors import DataError
from needlefit.project.folders import write_manifest
from needlefit.studies import run as runs
from needlefit.studies.load import load_target, read_data
from needlefit.viewer.opening import open_target

OPTIONS = "--quiet --jobs 1"


@pytest.fixture
def places(world, tmp_path, monkeypatch):
    """Copies of the project and of its runs, moved elsewhere; the third folder is the working folder."""
    found = SimpleNamespace(project=tmp_path / "project", moved=tmp_path / "moved", here=tmp_path / "here")
    world.find("prediction")  # with its figures: other tests read it
    for kind in ("fit", "cross_validation"):
        folder = world.find(kind)
        shutil.copytree(folder, found.moved / folder.name)
        timing = found.moved / folder.name / "timing.json"  # where the copy of the project is
        timing.write_text(timing.read_text().replace(str(world.folder), str(found.project)))
    copy_project(world, found.project)
    found.here.mkdir()
    shutil.copy(world.folder / "configs/scenes/ahead.toml", found.here)
    monkeypatch.chdir(found.here)
    draw_blank(monkeypatch)
    return found


def drop_copy(folder):
    """Make a run as one of an earlier version, which holds no data."""
    shutil.rmtree(folder / "dataset")
    write_manifest(folder)


def change_noise(file):
    text = file.read_text()
    assert "point_sd_mm = 0.05" in text
    file.write_text(text.replace("point_sd_mm = 0.05", "point_sd_mm = 0.06"))


def test_a_run_holds_the_files_of_its_data_with_their_digest(world):
    for kind in ("fit", "cross_validation"):
        folder = world.find(kind)
        kept = runs.restore_run(folder)
        copied = {
            path.relative_to(folder / "dataset").as_posix() for path in (folder / "dataset").rglob("*.*")
        }
        assert copied == {"dataset.toml", *kept.data.names} and "layers/gel.stl" in copied
        assert kept.data.digest() == kept.metadata.dataset.sha256
        assert json.loads((folder / "timing.json").read_text())["folder"] == str(world.folder)


@pytest.mark.parametrize(
    "line",
    [
        "report ../moved/gel --out again",
        f"predict ../moved/gel --scene ./ahead.toml {OPTIONS}",
        pytest.param(f"tune ../moved/held_out --no-sample {OPTIONS}", marks=pytest.mark.sweep),
        "plan ../moved/gel/needle-1 --target 28,1 --turns 0",
    ],
)
def test_every_command_takes_a_run_that_was_moved_alone(line, places, capsys):
    shutil.rmtree(places.project)
    assert run(line) in (0, 5)
    out = capsys.readouterr().out
    assert out and "plan reports/" not in out  # the run is not there


def test_a_moved_run_is_opened_with_its_measured_needle_and_draws(places):
    shutil.rmtree(places.project)
    shown = open_target("../moved/held_out/needle-2")
    assert shown.measured["id"] == "needle-2" and shown.spread is not None


@pytest.mark.parametrize(
    "use",
    [
        lambda folder: load_target(str(folder)),
        lambda folder: open_target(str(folder)),
        lambda folder: needlefit.predict(needlefit.load_run(folder), "./ahead.toml"),
    ],
)
def test_a_dataset_that_is_missing_is_named_with_both_folders(places, use):
    folder = places.moved / "gel"
    drop_copy(folder)
    assert use(folder)  # where it was
    shutil.rmtree(places.project)
    fault = refusal(DataError, "needles", lambda: use(folder))
    assert str(places.project / "data/needles") in fault.expected
    assert str(places.here / "data/needles") in fault.expected
    assert run("report ../moved/gel") == 0  # which needs no data


def test_a_missing_dataset_is_found_where_the_message_looked_for_it(places):
    drop_copy(places.moved / "gel")
    shutil.move(places.project / "data", places.here / "data")
    assert load_target("../moved/gel").inputs.dataset.digest
    file = places.here / "data/needles/dataset.toml"
    file.write_text(f"# later\n{file.read_text()}")
    assert load_target("../moved/gel")
    change_noise(file)
    fault = refusal(DataError, "changed", lambda: load_target("../moved/gel"))
    assert str(file) in fault.expected


def test_data_that_changed_since_are_named_and_the_copy_is_used(places, capsys):
    file = places.project / "data/needles/dataset.toml"
    file.write_text(f"# later\n{file.read_text()}")
    kinds = [one.kind for one in load_target("../moved/gel").inputs.dataset.warnings]
    assert "data_changed" not in kinds
    change_noise(file)
    dataset = load_target("../moved/gel").inputs.dataset
    (warning,) = [one for one in dataset.warnings if one.kind == "data_changed"]
    assert warning.where == str(file)
    assert run(f"predict ../moved/gel --scene ./ahead.toml {OPTIONS}") in (0, 5)
    printed = capsys.readouterr().err
    assert printed.count("explain data-changed") == 1 and f"{file}: " in printed
    assert [one for one in open_target("../moved/gel").warnings if one.kind == "data_changed"] == [warning]


@pytest.mark.parametrize("change", ["large", "gone", "changed", "outside"])
def test_data_that_are_too_large_or_not_as_they_were_are_not_kept(places, tmp_path, monkeypatch, change):
    kept = runs.restore_run(places.moved / "gel")
    data = DatasetFiles(
        places.project / "data/needles/dataset.toml", places.project / "data/needles", kept.data.names
    )
    object.__setattr__(kept, "data", data)
    if change == "large":
        monkeypatch.setattr(runs, "MAX_DATA_BYTES", 100)
    elif change == "gone":
        (data.root / data.names[0]).unlink()
    elif change == "changed":
        (data.root / data.names[0]).write_text("")
    else:
        names = tuple(f"../needles/{name}" for name in data.names)
        object.__setattr__(kept, "data", DatasetFiles(data.file, data.root, names))
    runs.store_run(kept, tmp_path)
    assert not (tmp_path / "dataset").exists()


def test_a_run_in_memory_finds_its_data_from_another_working_folder(places, monkeypatch):
    monkeypatch.chdir(places.project)
    found = needlefit.fit("./configs/fits/gel.toml", jobs=1)
    monkeypatch.chdir(places.here)
    assert read_data(found, "run").digest == found.metadata.dataset.sha256
