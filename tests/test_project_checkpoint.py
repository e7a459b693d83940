"""Checkpoints: what is whole is used, what is damaged is set aside, one process at a time; no code is run."""

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from made_again import read_files
from refusals import refusal

from needlefit.errors import ConfigError, DataError
from needlefit.project.checkpoint import open_checkpoint, remove_checkpoint, require_own_checkpoint
from needlefit.project.folders import (
    MANIFEST,
    find_changes,
    find_foreign,
    replace_file,
    replace_folder,
    require_unchanged,
)


def kept(folder):
    """A checkpoint of three rows; return its file."""
    checkpoint = open_checkpoint(folder, False, {"n": 1})
    for index in range(3):
        checkpoint.keep_row("fold/fit", {"index": index, "theta": [0.1, 0.2]})
    return next(folder.glob("*.jsonl"))


def resumed(folder):
    lines = []
    rows = open_checkpoint(folder, True, {"n": 1}, lines.append).rows("fold/fit")
    return [row["index"] for row in rows], lines


def test_a_row_is_whole_or_none(tmp_path):
    file = kept(tmp_path / "c")
    whole = file.read_bytes()
    for end in range(len(whole)):
        file.write_bytes(whole[:end])
        found, lines = resumed(tmp_path / "c")
        assert found == [*range(len(found))] and len(lines) <= 1
        assert len(found) == whole[:end].count(b"}")


@pytest.mark.parametrize(
    ("stamp", "resume"), [(b"", True), (b"\0" * 100, False), (b'{"program": "needlefit", "format": 1}', True)]
)
def test_a_checkpoint_with_a_damaged_stamp_is_begun_afresh(tmp_path, stamp, resume):
    file = kept(tmp_path / "c")
    (tmp_path / "c" / MANIFEST).write_bytes(stamp)
    lines = []
    checkpoint = open_checkpoint(tmp_path / "c", resume, {"n": 1}, lines.append)
    assert checkpoint.rows("fold/fit") == [] and len(lines) == 1
    assert not file.exists()


def test_a_checkpoint_of_other_work_is_refused_and_without_resume_emptied(tmp_path):
    kept(tmp_path / "c")
    refusal(ConfigError, "other work", open_checkpoint, tmp_path / "c", True, {"n": 2})
    assert open_checkpoint(tmp_path / "c", False, {"n": 2}).rows("fold/fit") == []


@pytest.mark.parametrize("name", ["notes.txt", "sub/data.csv", "0123456789abcdef.jsonl.mine"])
def test_foreign_files_are_kept_when_a_run_begins_and_ends(tmp_path, name):
    folder, lines = tmp_path / "c", []
    kept(folder)
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text("mine")
    for resume in (True, False):
        refusal(ConfigError, Path(name).name, open_checkpoint, folder, resume, {"n": 1})
    remove_checkpoint(folder, lines.append)
    assert (folder / name).read_text() == "mine" and name in lines[0]
    (folder / name).unlink()
    if name.startswith("sub/"):
        (folder / "sub").rmdir()
    remove_checkpoint(folder, lines.append)
    assert not folder.exists() and len(lines) == 1


HOLDS = """
import sys
from pathlib import Path
from needlefit.project.checkpoint import open_checkpoint
checkpoint = open_checkpoint(Path(sys.argv[1]), False, {"n": 1})
print("holds", flush=True)
sys.stdin.read()
"""


def test_one_process_at_a_time(tmp_path):
    words = [sys.executable, "-c", HOLDS, str(tmp_path / "c")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"holds\n"
        before = (tmp_path / "c" / MANIFEST).read_bytes()
        for resume in (True, False):
            refusal(ConfigError, "another run", open_checkpoint, tmp_path / "c", resume, {"n": 1})
        lines = []
        remove_checkpoint(tmp_path / "c", lines.append)
        assert len(lines) == 1 and (tmp_path / "c" / MANIFEST).read_bytes() == before
        os.kill(process.pid, signal.SIGKILL)
        process.wait(10)
    open_checkpoint(tmp_path / "c", True, {"n": 1})


def test_a_checkpoint_that_ended_before_its_manifest_is_begun_again(tmp_path):
    (tmp_path / "lock").touch()
    require_own_checkpoint(tmp_path)
    lines = []
    open_checkpoint(tmp_path, True, {"n": 1}, lines.append)
    assert lines == [] and json.loads((tmp_path / MANIFEST).read_text())["holds"] == "checkpoint"


def write(folder, text="one"):
    with replace_folder(folder) as fresh:
        (fresh / "part").mkdir()
        (fresh / "part" / "a.csv").write_text(text)
        (fresh / "timing.json").write_text(text)


def test_what_does_not_agree_with_the_manifest_is_named(tmp_path):
    folder = tmp_path / "out"
    write(folder)
    (folder / "timing.json").write_text("later")
    (folder / "notes.txt").write_text("mine")
    require_unchanged(folder)
    (folder / "part" / "a.csv").write_text("two")
    assert [*find_changes(folder)] == ["part/a.csv"]
    refusal(DataError, r"part/a\.csv", require_unchanged, folder)
    (folder / "part" / "a.csv").unlink()
    require_unchanged(folder)  # a report makes it again
    for text in (b"{", None):
        (folder / MANIFEST).unlink() if text is None else (folder / MANIFEST).write_bytes(text)
        refusal(DataError, MANIFEST, require_unchanged, folder)


def test_an_unchanged_result_is_replaced_and_has_the_same_manifest(tmp_path):
    folder = tmp_path / "out"
    write(folder)
    first = (folder / MANIFEST).read_bytes()
    assert json.loads(first)["files"].keys() == {"part/a.csv", "timing.json"}
    (folder / "timing.json").write_text("later")  # the one file that differs from run to run
    (folder / "part" / ".DS_Store").write_text("left by a file manager")
    write(folder)
    assert (folder / MANIFEST).read_bytes() == first
    write(folder, "two")
    assert (folder / "part" / "a.csv").read_text() == "two"
    (folder / "part" / "a.csv").unlink()
    write(folder, "three")
    assert {path.name for path in tmp_path.iterdir()} == {"out"}


@pytest.mark.parametrize(
    "file", ["part/a.csv", "notes.txt", ".hidden", "new/b.csv", "part/thesis.docx", MANIFEST]
)
def test_added_or_changed_files_are_kept_and_named(file, tmp_path):
    folder = tmp_path / "out"
    write(folder)
    (folder / file).parent.mkdir(exist_ok=True)
    (folder / file).write_text("mine")
    before = read_files(tmp_path)
    error = refusal(ConfigError, "", write, folder, "two")
    assert file in str(error) and "--out" in error.fix
    assert read_files(tmp_path) == before


def test_links_are_kept_and_not_followed(tmp_path):
    mine, folder = tmp_path / "mine", tmp_path / "out"
    mine.mkdir()
    (mine / "a.csv").write_text("mine")
    write(folder)
    shutil.rmtree(folder / "part")
    (folder / "part").symlink_to(mine)
    refusal(ConfigError, "part", write, folder, "two")
    (folder / "part").unlink()
    (folder / "part").mkdir()
    (folder / "part" / "a.csv").symlink_to(mine / "a.csv")
    refusal(ConfigError, r"part/a\.csv", write, folder, "two")
    assert (mine / "a.csv").read_text() == "mine"


def test_a_manifest_that_lists_files_elsewhere_removes_none(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    folder = tmp_path / "out"
    write(folder)
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["files"] |= {"../mine.txt": None, str(tmp_path / "mine.txt"): None}
    (folder / MANIFEST).write_text(json.dumps(manifest))
    write(folder, "two")
    assert (tmp_path / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("files", [["thesis.docx"], {"thesis.docx": None}, {"thesis.docx": 0}, None])
def test_a_manifest_without_a_digest_owns_nothing(files, tmp_path):
    (tmp_path / "thesis.docx").write_text("mine")
    manifest = {"program": "needlefit", "format": 1, "holds": "result", "files": files}
    (tmp_path / MANIFEST).write_text(json.dumps(manifest))
    assert any(one.startswith("thesis.docx") for one in find_foreign(tmp_path))


@pytest.mark.parametrize("is_empty", [False, True])
def test_what_cannot_be_put_in_place_leaves_the_folder_as_it_was(tmp_path, monkeypatch, is_empty):
    folder, real = tmp_path / "out", Path.rename

    def rename(path, target):
        if path.name == "timing.json" if is_empty else path.parent.name == "new":
            raise OSError(5, "Input/output error", str(path))
        return real(path, target)

    folder.mkdir() if is_empty else write(folder)
    before = read_files(tmp_path)
    with monkeypatch.context() as patch, pytest.raises(OSError):
        patch.setattr(Path, "rename", rename)
        write(folder, "two")
    assert read_files(tmp_path) == before and [*tmp_path.iterdir()] == [folder]


def test_a_new_folder_gets_no_manifest_and_replaces_nothing(tmp_path):
    (tmp_path / "empty").mkdir()
    with replace_folder(tmp_path / "empty", is_result=False) as fresh:
        (fresh / "dataset.toml").write_text("")
    assert [path.name for path in (tmp_path / "empty").iterdir()] == ["dataset.toml"]
    with (
        pytest.raises(ConfigError, match="exists already"),
        replace_folder(tmp_path / "late", is_result=False) as fresh,
    ):
        (fresh / "dataset.toml").write_text("")
        (tmp_path / "late").mkdir()
        (tmp_path / "late" / "mine").write_text("mine")
    assert [path.name for path in (tmp_path / "late").iterdir()] == ["mine"]


@pytest.mark.parametrize("is_result", [True, False])
def test_an_empty_working_folder_is_filled_and_stays_the_same_folder(tmp_path, monkeypatch, is_result):
    place = tmp_path / "here"
    place.mkdir()
    monkeypatch.chdir(place)
    before = place.stat().st_ino
    with pytest.raises(ZeroDivisionError), replace_folder(Path(), is_result) as fresh:
        (fresh / "part").mkdir()
        raise ZeroDivisionError
    assert not any(place.iterdir())
    with replace_folder(Path(), is_result) as fresh:
        (fresh / "part").mkdir()
        (fresh / "part" / "a.csv").touch()
    assert place.stat().st_ino == before and Path("part/a.csv").is_file()
    assert Path(MANIFEST).is_file() == is_result and [*tmp_path.iterdir()] == [place]


@pytest.mark.parametrize("inside", ["", "part"])
@pytest.mark.parametrize("is_result", [True, False])
def test_a_folder_is_not_replaced_by_who_stands_in_it(tmp_path, monkeypatch, inside, is_result):
    write(tmp_path / "out")
    monkeypatch.chdir(tmp_path / "out" / inside)
    for folder in (Path(os.path.relpath(tmp_path / "out")), tmp_path / "out"):
        with pytest.raises(ConfigError), replace_folder(folder, is_result) as fresh:
            (fresh / "new").touch()
    assert not find_foreign(tmp_path / "out") and Path.cwd() == tmp_path / "out" / inside


# --- a process that is killed while it writes --------------------------------------------------------

WRITES = """
import sys
from pathlib import Path
from needlefit.project.folders import {verb}
with {verb}(Path(sys.argv[1])) as fresh:
    print("writing", flush=True)
    sys.stdin.read()
"""


def writing(place, verb):
    """A process in the middle of writing `place`."""
    words = [sys.executable, "-c", WRITES.format(verb=verb), str(place)]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"writing\n"
    return process


def end(process, how):
    os.kill(process.pid, how)
    process.wait(10)
    process.stdin.close()
    process.stdout.close()


def write_empty(place, verb):
    if verb == "replace_folder":
        with replace_folder(place) as fresh:
            (fresh / "whole").touch()
    else:
        with replace_file(place) as fresh:
            fresh.write_text("whole")


@pytest.mark.parametrize("verb", ["replace_folder", "replace_file"])
def test_leftovers_of_a_killed_process_are_removed_and_a_running_one_is_not_disturbed(verb, tmp_path):
    place, mine = tmp_path / "out", tmp_path / ".out.abcdefgh"
    (mine / "notes").mkdir(parents=True)
    process = writing(place, verb)
    refusal(ConfigError, "another run", write_empty, place, verb)
    end(process, signal.SIGKILL)
    assert len(list(tmp_path.glob(".out.needlefit"))) == 1
    write_empty(place, verb)
    assert set(tmp_path.iterdir()) == {place, mine} and (mine / "notes").is_dir()


def test_the_only_copy_is_restored(tmp_path):
    """Killed between two renamings: the earlier folder stands in the scratch folder alone."""
    process = writing(tmp_path / "out", "replace_folder")
    (scratch,) = tmp_path.iterdir()
    (scratch / "old").mkdir()
    (scratch / "old" / "notes.txt").write_text("mine")
    end(process, signal.SIGKILL)
    with pytest.raises(ConfigError, match=r"notes\.txt"), replace_folder(tmp_path / "out") as fresh:
        (fresh / "whole").touch()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


class Bomb:
    def __reduce__(self):
        return (Path.touch, (Path("was_run"),))


@pytest.mark.parametrize("data", [pickle.dumps(Bomb()), b"\xff" * 50, b"{}", b"[" * 10_000])
def test_a_pickle_is_not_run(tmp_path, monkeypatch, data):
    monkeypatch.chdir(tmp_path)
    file = kept(tmp_path / "c")
    file.write_bytes(data)
    assert resumed(tmp_path / "c")[0] == [] and not (tmp_path / "was_run").exists()
