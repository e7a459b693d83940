"""Names that a spreadsheet, a terminal or a file system would act on are refused, wherever they come from."""

from pathlib import Path

import pandas as pd
import pytest
from refusals import refusal
from track_cases import HEAD, TOML

from needlefit.datasets.read import check, read
from needlefit.datasets.template import write_template
from needlefit.errors import ConfigError, DataError
from needlefit.imaging.scans import make_scans, read_scans
from needlefit.project.locate import find_studies, find_study_or_fit, shipped_folder
from needlefit.project.toml import check as check_tables
from needlefit.schemas.names import file_name_fault, name_fault
from needlefit.schemas.tracks import TrackFitRecord

BAD = [
    "=1+1",
    "+1",
    "-1",
    "@SUM",
    " =1",
    "\uff1d1",
    "a\tb",
    "a\rb",
    "a\nb",
    "a\x1b[2J",
    "\u202eabc",
    "a\u200bb",
]
GOOD = ["liver 1", "µ-phantom", "piece-1", "a=b", "3+4", "Lendenstück", "x" * 200, ""]


def test_names_that_a_spreadsheet_a_terminal_or_a_file_system_would_act_on():
    for name in BAD:
        assert name_fault(name) and file_name_fault(name)
    for name in GOOD:
        assert name_fault(name) == ""
    for name in ["", ".", "..", "a/b", "../a", "a\\b", "x" * 201]:
        assert file_name_fault(name)


def with_specimen(folder: Path, name: str) -> Path:
    write_template(folder)
    table = pd.read_csv(folder / "insertions.csv", dtype=str, keep_default_na=False)
    table.loc[1, "specimen"] = name
    table.to_csv(folder / "insertions.csv", index=False)
    return folder


@pytest.mark.parametrize("name", [name for name in BAD if name.strip() == name and "\r" not in name])
def test_a_specimen_is_refused_with_file_and_line(name, tmp_path):
    (fault,) = check(with_specimen(tmp_path / "mine", name))
    assert "insertions.csv:3" in str(fault.where) and fault.what.isprintable()


@pytest.mark.parametrize("key", ['name = "{}"', '[media."{}"]'])
def test_the_name_and_the_media_of_a_dataset_are_refused_with_file_and_key(key, tmp_path):
    file = write_template(tmp_path / "mine")
    old = 'name = "mine"' if key.startswith("name") else "[media.medium1]"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, key.format("=cmd"), 1).replace("[[media.medium1", '[[media."=cmd"'))
    error = refusal((ConfigError, DataError), "", read, file)
    assert "dataset.toml" in str(error) and "=cmd" in str(error)


def test_names_of_tracks_and_scans_are_refused_with_their_line(tmp_path):
    rows = "".join(f"=run,gel,{n},0.1,0,1\n" for n in range(9))
    (tmp_path / "steps.csv").write_text(HEAD + rows)
    (tmp_path / "dataset.toml").write_text(TOML)
    error = refusal(DataError, "=run", read, tmp_path / "dataset.toml")
    assert "steps.csv:2" in str(error)
    tables = {"name": "../fit", "medium": "gel", "tune": {}, "validate": {}}
    refusal(ConfigError, r"\.\./fit", check_tables, tables, TrackFitRecord, "study")
    (tmp_path := tmp_path / "b").mkdir()
    volume = shipped_folder() / "data" / "sample_scan" / "volumes" / "sample.nrrd"
    (tmp_path / "=cmd.nrrd").symlink_to(volume)
    (tmp_path / "good.nrrd").symlink_to(volume)
    refusal(DataError, "=cmd", make_scans, [tmp_path / "=cmd.nrrd"])
    refusal(DataError, "=gel", make_scans, [tmp_path / "good.nrrd"], medium="=gel")
    (tmp_path / "scans.csv").write_text("scan,specimen\ngood.nrrd,+piece\n=cmd.nrrd,\n")
    error = refusal(DataError, "", read_scans, tmp_path / "scans.csv")
    assert "scans.csv:2" in str(error) and "+piece" in str(error) and "=cmd" in str(error)


@pytest.mark.parametrize("name", ["=study", "-x", "@x"])
def test_studies_and_folders_are_refused(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / f"{name}.toml"
    file.write_text((shipped_folder() / "studies" / "study1.toml").read_text())
    for finds in (find_studies, find_study_or_fit):
        refusal(ConfigError, "refused", finds, f"./{name}.toml")
    refusal(ConfigError, "refused", write_template, tmp_path / name)
    assert not (tmp_path / name).exists()
