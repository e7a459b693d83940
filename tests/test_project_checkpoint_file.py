"""Files of finished work: data with a digest; whatever was changed in them is seen, and no code is run."""

import dataclasses
import hashlib
import json
import os
import pickle
import random
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.project.checkpoint_file import (
    CheckpointContent,
    read_checkpoint_file,
    set_aside,
    write_checkpoint_file,
)
from needlefit.project.encode import decode, encode

FLIPS = 300
ARRAYS = {
    "a": np.arange(6.0).reshape(2, 3),
    "b": np.array([], np.int64),
    "c": np.array([True, False]),
    "d": np.array([[np.nan]], np.float32),
}


def write(path: Path) -> bytes:
    write_checkpoint_file(path, "test", "stamp", CheckpointContent({"x": [1.5, None, float("inf")]}, ARRAYS))
    return path.read_bytes()


def test_written_data_are_read_back_and_written_to_the_same_bytes(tmp_path):
    assert write(tmp_path / "a.checkpoint") == write(tmp_path / "b.checkpoint")
    kept = read_checkpoint_file(tmp_path / "a.checkpoint", "test", "stamp")
    assert kept.values == {"x": [1.5, None, float("inf")]}
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(kept.arrays[name], array)
        assert kept.arrays[name].dtype == array.dtype
    assert read_checkpoint_file(tmp_path / "a.checkpoint", "test", "other") is None
    with pytest.raises(DataError, match="kind other"):
        read_checkpoint_file(tmp_path / "a.checkpoint", "other", "stamp")


def test_every_changed_byte_is_detected(tmp_path):
    path, chance = tmp_path / "a.checkpoint", random.Random(1)
    whole = write(path)
    for _ in range(FLIPS):
        data = bytearray(whole)
        at = chance.randrange(len(data))
        data[at] ^= 1 << chance.randrange(8)
        path.write_bytes(data)
        with suppress(DataError):
            assert read_checkpoint_file(path, "test", "stamp") is None  # the stamp was hit
        path.write_bytes(whole[:at])
        with pytest.raises(DataError):
            read_checkpoint_file(path, "test", "stamp")


def forged(path: Path, table: object, data: bytes = b"") -> Path:
    """A file whose digest is right, and whose content is not."""
    body = json.dumps(table).encode() + b"\n" + data
    head = {"needlefit": "test", "format": 1, "stamp": "stamp", "bytes": len(body)}
    head["sha256"] = hashlib.sha256(body).hexdigest()
    path.write_bytes(json.dumps(head).encode() + b"\n" + body)
    return path


@pytest.mark.parametrize(
    "row",
    [
        *(["a", "|O", [1]], ["a", "<U8", [1]], ["a", "<f8", [-1]], ["a", "<f8", [2**39]], ["a", "<f8", [2]]),
        *(["a", "|b1", [3]], ["a", "<f8", [0]]),  # four bytes follow
        *(["a", "<f8", ["1"]], ["a", "<f8", [True]], ["a", "<f8", []], ["a", "<f8", 1], ["a"], "a", None),
    ],
)
def test_forged_contents_with_the_right_digest_are_refused(tmp_path, row):
    with pytest.raises(DataError):
        read_checkpoint_file(
            forged(tmp_path / "a", {"values": {}, "arrays": [row]}, b"1234"), "test", "stamp"
        )


@pytest.mark.parametrize("table", [[], {}, {"values": {}}, {"values": [], "arrays": []}, 7])
def test_a_file_without_a_table_is_refused(tmp_path, table):
    with pytest.raises(DataError):
        read_checkpoint_file(forged(tmp_path / "a", table), "test", "stamp")


class Bomb:
    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("was_run"),))


@pytest.mark.parametrize("data", [pickle.dumps(Bomb()), b"", b"\xff" * 50, b"{}", b"[" * 10_000])
def test_a_pickle_is_not_run(tmp_path, monkeypatch, data):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").write_bytes(data)
    with pytest.raises(DataError):
        read_checkpoint_file(tmp_path / "a", "test", "stamp")
    assert not (tmp_path / "was_run").exists()


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
