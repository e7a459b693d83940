"""Checkpoints: what is whole is used, what is damaged is set aside, one process at a time; no code is run."""

import dataclasses
import errno
import hashlib
import json
import os
import pickle
import random
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from needlefit.errors import ConfigError
from needlefit.inference.fit import Start, keep_start, read_starts
from needlefit.project.checkpoint import (
    ARRAYS_KEY,
    open_checkpoint,
    release_checkpoint,
    remove_checkpoint,
    require_own_checkpoint,
    set_aside,
)
from needlefit.project.encode import decode, encode
from needlefit.project.folders import MANIFEST

START = Start(0, (0.1,), (0.2,), 0.3, 4, 0, "tolerance")
FLIPS = 300


def kept(folder: Path) -> Path:
    """A checkpoint of three starts; return its file."""
    checkpoint = open_checkpoint(folder, False, {"n": 1})
    for index in range(3):
        keep_start(checkpoint, "fold/fit", dataclasses.replace(START, index=index))
    return next(folder.glob("*.jsonl"))


def resumed(folder: Path) -> tuple[list[int], list[str]]:
    lines: list[str] = []
    return sorted(read_starts(open_checkpoint(folder, True, {"n": 1}, lines.append), "fold/fit")), lines


def test_a_truncated_line_is_no_start(tmp_path):
    file = kept(tmp_path / "c")
    with file.open("a") as stream:
        stream.write('{"index": 1, "theta0": [0.')
    before = file.read_bytes()
    checkpoint = open_checkpoint(tmp_path / "c", True, {"n": 1})
    keep_start(checkpoint, "fold/fit", dataclasses.replace(START, index=5))
    assert sorted(read_starts(checkpoint, "fold/fit")) == [0, 1, 2, 5]
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
    assert read_starts(checkpoint, "fold/fit") == {}
    keep_start(checkpoint, "fold/fit", START)
    assert list(read_starts(checkpoint, "fold/fit")) == [0]
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
    (tmp_path / "c" / MANIFEST).write_bytes(stamp)
    (tmp_path / "c.damaged-1").mkdir()
    (tmp_path / "c.damaged-1" / "mine").touch()
    lines: list[str] = []
    checkpoint = open_checkpoint(tmp_path / "c", resume, {"n": 1}, lines.append)
    assert read_starts(checkpoint, "fold/fit") == {} and len(lines) == 1
    assert (tmp_path / "c.damaged-2" / file.name).is_file() and (tmp_path / "c.damaged-1" / "mine").is_file()


@pytest.mark.parametrize(
    "text", [b"mine", b"\xff\xfe", b"[]", b'{"program": "other"}', b'{"program": "needlefit", "format": 2}']
)
def test_a_folder_with_a_foreign_stamp_is_kept(tmp_path, text):
    folder, lines = tmp_path / "c", []
    folder.mkdir()
    (folder / MANIFEST).write_bytes(text)
    (folder / "thesis.checkpoint").write_text("mine")
    for resume in (True, False):
        with pytest.raises(ConfigError, match=r"thesis\.checkpoint"):
            open_checkpoint(folder, resume, {"n": 1})
    remove_checkpoint(folder, lines.append)
    assert len(lines) == 1
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        MANIFEST: text,
        "thesis.checkpoint": b"mine",
    }


def test_a_checkpoint_of_other_work_is_refused_and_without_resume_emptied(tmp_path):
    kept(tmp_path / "c")
    with pytest.raises(ConfigError, match="other work"):
        open_checkpoint(tmp_path / "c", True, {"n": 2})
    assert read_starts(open_checkpoint(tmp_path / "c", False, {"n": 2}), "fold/fit") == {}


@pytest.mark.parametrize("name", ["notes.txt", "sub/data.csv", "0123456789abcdef.jsonl.mine"])
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
from needlefit.project.checkpoint import open_checkpoint
checkpoint = open_checkpoint(Path(sys.argv[1]), False, {"n": 1})
print("holds", flush=True)
sys.stdin.read()
"""


def test_one_process_at_a_time(tmp_path):
    pytest.importorskip("fcntl")
    words = [sys.executable, "-c", HOLDS, str(tmp_path / "c")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"holds\n"
        before = (tmp_path / "c" / MANIFEST).read_bytes()
        for resume in (True, False):
            with pytest.raises(ConfigError, match=str(process.pid)):
                open_checkpoint(tmp_path / "c", resume, {"n": 1})
        lines: list[str] = []
        remove_checkpoint(tmp_path / "c", lines.append)
        assert len(lines) == 1 and (tmp_path / "c" / MANIFEST).read_bytes() == before
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
    assert json.loads((tmp_path / "a" / MANIFEST).read_text())["holds"] == "checkpoint"


@pytest.mark.parametrize("begun", ["", "123 0123456789abcdef\n", "12"])
@pytest.mark.parametrize("half", [None, "", '{\n  "prog'])
def test_a_checkpoint_that_ended_before_its_manifest_is_begun_again(begun, half, tmp_path):
    (tmp_path / "lock").write_text(begun)
    if half is not None:
        (tmp_path / MANIFEST).write_text(half)
    require_own_checkpoint(tmp_path)
    lines: list[str] = []
    open_checkpoint(tmp_path, True, {"n": 1}, lines.append)
    assert lines == [] and json.loads((tmp_path / MANIFEST).read_text())["holds"] == "checkpoint"


@pytest.mark.parametrize("file", ["lock", "notes.txt", "0123456789abcdef.jsonl"])
def test_somebody_else_s_folder_with_a_lock_is_no_checkpoint(file, tmp_path):
    (tmp_path / "lock").write_text("")
    (tmp_path / file).write_text("mine\n")
    with pytest.raises(ConfigError):
        require_own_checkpoint(tmp_path)


# --- arrays ---------------------------------------------------------------------------------------------

ROW = {"x": [1.5, None, float("inf")]}
ARRAYS = {
    "a": np.arange(6.0).reshape(2, 3),
    "b": np.array([], np.int64),
    "c": np.array([True, False]),
    "d": np.array([[np.nan]], np.float32),
}


def test_arrays_are_read_back(tmp_path):
    checkpoint = open_checkpoint(tmp_path, False, {"n": 1})
    checkpoint.keep_row("a", ROW, ARRAYS)
    (row,) = checkpoint.rows("a")
    assert row["x"] == ROW["x"]
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(row[ARRAYS_KEY][name], array)
        assert row[ARRAYS_KEY][name].dtype == array.dtype
    with pytest.raises(TypeError):
        checkpoint.keep_row("a", ROW, {"a": np.array(["text"])})


@pytest.mark.parametrize(
    "stored",
    [
        *(["|O", [1], "MTIzNA=="], ["<U8", [1], "MTIzNA=="], ["<f8", [-1], ""], ["<f8", [2**39], ""]),
        *(["<f8", [2], "MTIzNA=="], ["|b1", [3], "MTIzNA=="], ["<f8", [0], "MTIzNA=="], ["<f8", ["1"], ""]),
        *(["<f8", [True], ""], ["<f8", [], ""], ["<f8", 1, ""], ["<f8"], "a", None, ["|b1", [3], "MTI$"]),
    ],
)
def test_forged_arrays_with_the_right_digest_are_set_aside(tmp_path, stored):
    lines: list[str] = []
    checkpoint = open_checkpoint(tmp_path, False, {"n": 1}, lines.append)
    checkpoint.keep_row("a", {ARRAYS_KEY: {"a": stored}})
    assert checkpoint.rows("a") == [] and len(lines) == 1


class Bomb:
    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("was_run"),))


@pytest.mark.parametrize("data", [pickle.dumps(Bomb()), b"\xff" * 50, b"{}", b"[" * 10_000])
def test_a_pickle_is_not_run(tmp_path, monkeypatch, data):
    monkeypatch.chdir(tmp_path)
    file = kept(tmp_path / "c")
    file.write_bytes(data)
    assert resumed(tmp_path / "c")[0] == [] and not (tmp_path / "was_run").exists()


def test_setting_aside_overwrites_nothing(tmp_path):
    for name in ("a", "a.damaged-1", "a.damaged-3"):
        (tmp_path / name).write_text(name)
    assert set_aside(tmp_path / "a").name == "a.damaged-2"
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "a.damaged-1": "a.damaged-1",
        "a.damaged-2": "a",
        "a.damaged-3": "a.damaged-3",
    }


def test_a_name_taken_meanwhile_is_not_overwritten(tmp_path, monkeypatch):
    link = os.link

    def link_later(path, aside):
        if aside.name.endswith("-1"):
            aside.write_text("theirs")
        link(path, aside)

    (tmp_path / "a").write_text("mine")
    monkeypatch.setattr(os, "link", link_later)
    assert set_aside(tmp_path / "a").read_text() == "mine"
    assert (tmp_path / "a.damaged-1").read_text() == "theirs" and not (tmp_path / "a").exists()


def test_setting_aside_on_a_disk_without_links(tmp_path, monkeypatch):
    def no_link(*_):
        raise OSError(1, "Operation not permitted")

    (tmp_path / "a").write_text("mine")
    monkeypatch.setattr(os, "link", no_link)
    assert set_aside(tmp_path / "a").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["a.damaged-1"]


@dataclass(frozen=True)
class Inner:
    points: NDArray[np.float64]
    kind: Literal["sheet", "solid"]


@dataclass(frozen=True)
class Outer:
    name: str
    parts: tuple[Inner, ...]
    pair: tuple[int, float]
    path: Path
    maybe: Inner | None = None


ONE = Outer("µ", (Inner(np.ones((2, 3)), "solid"),), (1, 0.5), Path("a/b"))


def test_a_dataclass_round_trips():
    arrays = {}
    plain = json.loads(json.dumps(encode(dataclasses.replace(ONE, maybe=ONE.parts[0]), {}, arrays)))
    again = decode(Outer, plain, {}, arrays)
    assert (again.name, again.pair, again.path) == (ONE.name, ONE.pair, ONE.path)
    np.testing.assert_array_equal(again.parts[0].points, np.ones((2, 3)))
    assert again.maybe.kind == "solid"


@pytest.mark.parametrize(
    "change",
    [
        *({"name": 1}, {"name": None}, {"pair": [1]}, {"pair": ["1", 2]}, {"pair": 1}, {"path": 7}),
        *({"parts": {}}, {"parts": [{"points": ".parts.0.points", "kind": "other"}]}),
        *({"parts": [{"points": "none", "kind": "solid"}]}, {"parts": [{"points": ["x"], "kind": "solid"}]}),
        *({"maybe": []}, {"more": 1}, {"pair": [True, 2.0]}),
    ],
)
def test_values_of_undeclared_types_are_refused(change):
    arrays = {}
    plain = encode(ONE, {}, arrays)
    with pytest.raises(ValueError):
        decode(Outer, {**plain, **change}, {}, arrays)
