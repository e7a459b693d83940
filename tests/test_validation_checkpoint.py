"""Checkpoints: what is whole is used, what is damaged is set aside, one process at a time."""

import dataclasses
import errno
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from needlefit.errors import ConfigError
from needlefit.inference.fit import Start
from needlefit.project.checkpoint_folder import release_checkpoint, remove_checkpoint
from needlefit.project.ownership import STAMP
from needlefit.studies.checkpoint import open_checkpoint

START = Start(0, (0.1,), (0.2,), 0.3, 4, 0, "tolerance")
FLIPS = 300


def kept(folder: Path) -> Path:
    """A checkpoint of three starts; return its file."""
    checkpoint = open_checkpoint(folder, False, {"n": 1})
    for index in range(3):
        checkpoint.keep("fold/fit", dataclasses.replace(START, index=index))
    return next(folder.glob("*.jsonl"))


def resumed(folder: Path) -> tuple[list[int], list[str]]:
    lines: list[str] = []
    return sorted(open_checkpoint(folder, True, {"n": 1}, lines.append).finished("fold/fit")), lines


def test_a_truncated_line_is_no_start(tmp_path):
    file = kept(tmp_path / "c")
    with file.open("a") as stream:
        stream.write('{"index": 1, "theta0": [0.')
    before = file.read_bytes()
    checkpoint = open_checkpoint(tmp_path / "c", True, {"n": 1})
    checkpoint.keep("fold/fit", dataclasses.replace(START, index=5))
    assert sorted(checkpoint.finished("fold/fit")) == [0, 1, 2, 5]
    aside = file.with_name(f"{file.name}.damaged-1")
    assert aside.read_bytes().startswith(before)
    del checkpoint
    assert resumed(tmp_path / "c") == ([0, 1, 2, 5], [])  # reported once


def test_a_changed_byte_never_changes_a_start(tmp_path):
    file, chance = kept(tmp_path / "c"), random.Random(1)
    whole = file.read_bytes()
    rows = {line for line in whole.split(b"\n") if line}
    for _ in range(FLIPS):
        data = bytearray(whole)
        data[chance.randrange(len(data))] = chance.randrange(256)
        file.write_bytes(data[: chance.choice([len(data), chance.randrange(len(data))])])
        found, lines = resumed(tmp_path / "c")
        left = {line for line in file.read_bytes().split(b"\n") if line}
        assert left <= rows and len(found) == len(left)  # what was damaged is set aside, what is whole stays
        assert len(lines) <= 1
        for aside in file.parent.glob("*.damaged-*"):
            aside.unlink()


def test_rows_of_another_task_are_ignored(tmp_path):
    kept(tmp_path / "c")
    checkpoint = open_checkpoint(tmp_path / "c", True, {"n": 1})
    checkpoint.keep_row("fold/fit", {"index": "no start"})
    assert checkpoint.finished("fold/fit") == {}
    checkpoint.keep("fold/fit", START)
    assert list(checkpoint.finished("fold/fit")) == [0]
    checkpoint.keep_row("pieces", {"piece": "a", "rows": {}})
    checkpoint.keep_row("pieces", {"piece": "b"})
    assert [row["piece"] for row in checkpoint.rows("pieces", ("piece", "rows"))] == ["a"]


def test_a_row_that_is_no_text_is_set_aside_whatever_its_digest(tmp_path):
    file, row = kept(tmp_path / "c"), b'{"index": "\xff"}'
    with file.open("ab") as stream:
        stream.write(hashlib.sha256(row).hexdigest()[:16].encode() + b" " + row + b"\n")
    found, lines = resumed(tmp_path / "c")
    assert found == [0, 1, 2] and len(lines) == 1


@pytest.mark.parametrize(
    "stamp",
    [
        b"",
        b"{",
        b"\0" * 100,
        b'{\n  "program": "needlefit",\n\0\0\0\0',
        b'{\n  "program": "needlefit",\n  "format": 1,\n  "holds": "checkpoint",\n  "work": "0\xff}',
        b'{"program": "needlefit", "format": 1}',
    ],
)
@pytest.mark.parametrize("resume", [True, False])
def test_a_checkpoint_with_a_damaged_stamp_is_set_aside_whole(tmp_path, stamp, resume):
    file = kept(tmp_path / "c")
    (tmp_path / "c" / STAMP).write_bytes(stamp)
    (tmp_path / "c.damaged-1").mkdir()
    (tmp_path / "c.damaged-1" / "mine").touch()
    lines: list[str] = []
    checkpoint = open_checkpoint(tmp_path / "c", resume, {"n": 1}, lines.append)
    assert checkpoint.finished("fold/fit") == {} and len(lines) == 1
    assert (tmp_path / "c.damaged-2" / file.name).is_file() and (tmp_path / "c.damaged-1" / "mine").is_file()


@pytest.mark.parametrize(
    "text", [b"mine", b"\xff\xfe", b"[]", b'{"program": "other"}', b'{"program": "needlefit", "format": 2}']
)
def test_a_folder_with_a_foreign_stamp_is_kept(tmp_path, text):
    folder, lines = tmp_path / "c", []
    folder.mkdir()
    (folder / STAMP).write_bytes(text)
    (folder / "thesis.checkpoint").write_text("mine")
    for resume in (True, False):
        with pytest.raises(ConfigError, match=r"thesis\.checkpoint"):
            open_checkpoint(folder, resume, {"n": 1})
    remove_checkpoint(folder, lines.append)
    assert len(lines) == 1
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        STAMP: text,
        "thesis.checkpoint": b"mine",
    }


def test_a_checkpoint_of_other_work_is_refused_and_without_resume_emptied(tmp_path):
    kept(tmp_path / "c")
    with pytest.raises(ConfigError, match="other work"):
        open_checkpoint(tmp_path / "c", True, {"n": 2})
    assert open_checkpoint(tmp_path / "c", False, {"n": 2}).finished("fold/fit") == {}


@pytest.mark.parametrize("name", ["notes.txt", "sub/data.csv", "0123456789abcdef.posterior/mine.csv"])
def test_foreign_files_are_kept_when_a_run_begins_and_ends(tmp_path, name):
    folder, lines = tmp_path / "c", []
    kept(folder)
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text("mine")
    for resume in (True, False):
        with pytest.raises(ConfigError, match=Path(name).name):
            open_checkpoint(folder, resume, {"n": 1})
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
from needlefit.studies.checkpoint import open_checkpoint
checkpoint = open_checkpoint(Path(sys.argv[1]), False, {"n": 1})
print("holds", flush=True)
sys.stdin.read()
"""


def test_one_process_at_a_time(tmp_path):
    pytest.importorskip("fcntl")
    words = [sys.executable, "-c", HOLDS, str(tmp_path / "c")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"holds\n"
        before = (tmp_path / "c" / STAMP).read_bytes()
        for resume in (True, False):
            with pytest.raises(ConfigError, match=str(process.pid)):
                open_checkpoint(tmp_path / "c", resume, {"n": 1})
        lines: list[str] = []
        remove_checkpoint(tmp_path / "c", lines.append)
        assert len(lines) == 1 and (tmp_path / "c" / STAMP).read_bytes() == before
        os.kill(process.pid, signal.SIGKILL)
        process.wait(10)
    open_checkpoint(tmp_path / "c", True, {"n": 1})


def test_a_full_disk_is_the_reason_why_a_checkpoint_cannot_be_opened(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "open", full)
    with pytest.raises(ConfigError, match=os.strerror(errno.ENOSPC)):
        open_checkpoint(tmp_path / "c", False, {"n": 1})


def test_a_lock_is_free_again_once_it_is_released(tmp_path):
    pytest.importorskip("fcntl")
    words = [sys.executable, "-c", HOLDS, str(tmp_path / "c")]
    open_checkpoint(tmp_path / "c", False, {"n": 1})
    open_checkpoint(tmp_path / "c", True, {"n": 1})  # the same process has it
    refused = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert refused.returncode and f"process {os.getpid()}" in refused.stderr
    release_checkpoint(tmp_path / "c")
    subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, check=True)


def test_the_bytes_of_a_row_are_the_same_each_time(tmp_path):
    one, two = kept(tmp_path / "a"), kept(tmp_path / "b")
    assert one.read_bytes() == two.read_bytes()
    assert json.loads((tmp_path / "a" / STAMP).read_text())["holds"] == "checkpoint"
