"""A folder that knows its own files is replaced; one that somebody touched is not."""

import json

import pytest

from needlefit.errors import ConfigError
from needlefit.project.manifest import replacing_own, write_manifest


def write(folder, text="one"):
    with replacing_own(folder, "own.json") as fresh:
        (fresh / "part").mkdir()
        (fresh / "part" / "a.csv").write_text(text)
        write_manifest(fresh, "own.json", {"versions": {}})


def test_what_nobody_touched_is_replaced(tmp_path):
    folder = tmp_path / "out"
    write(folder)
    write(folder, "two")
    assert (folder / "part" / "a.csv").read_text() == "two"
    said = json.loads((folder / "own.json").read_text())
    assert list(said) == ["versions", "files"] and list(said["files"]) == ["part/a.csv"]


@pytest.mark.parametrize(
    ("file", "why"),
    [
        ("part/a.csv", "was changed since"),
        ("notes.txt", "put there by somebody else"),
        ("own.json", "no own.json that can be read"),
    ],
)
def test_what_somebody_touched_is_kept(file, why, tmp_path):
    folder = tmp_path / "out"
    write(folder)
    (folder / file).write_text("mine")
    with pytest.raises(ConfigError, match=why) as error:
        write(folder, "two")
    assert "--out" in error.value.mend
    assert (folder / file).read_text() == "mine"


def test_a_file_or_a_folder_of_somebody_is_kept(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ConfigError, match="it is a file"):
        write(tmp_path / "file")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.tex").write_text("mine")
    with pytest.raises(ConfigError, match=r"no own\.json"):
        write(tmp_path / "folder")
    assert (tmp_path / "folder" / "thesis.tex").read_text() == "mine"


def test_a_file_put_there_meanwhile_is_kept(tmp_path):
    folder = tmp_path / "out"
    write(folder)
    with pytest.raises(ConfigError, match="somebody else"), replacing_own(folder, "own.json") as fresh:
        (fresh / "new.csv").write_text("new")
        (folder / "notes.txt").write_text("mine")
    assert not (folder / "new.csv").exists()
