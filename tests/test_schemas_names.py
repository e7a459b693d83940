"""Names that a spreadsheet, a terminal or a file system would act on are refused, wherever they come from."""

from pathlib import Path

import pandas as pd
import pytest
from refusals import refusal
from test_datasets import write_mine

from needlefit.datasets.read import check, read
from needlefit.errors import ConfigError, DataError
from needlefit.schemas.names import file_name_fault, name_fault

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
    write_mine(folder)
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
    file = write_mine(tmp_path / "mine")
    old = 'name = "mine"' if key.startswith("name") else "[media.medium1]"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, key.format("=cmd"), 1))
    error = refusal((ConfigError, DataError), "", read, file)
    assert "dataset.toml" in str(error) and "=cmd" in str(error)
