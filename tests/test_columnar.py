"""Frames in Parquet files: values, bytes and columns are those of frames in memory."""

import gc
import math
import pickle
import re
import tempfile

import pandas as pd
import pytest

from needlefit.errors import ConfigError, DataError
from needlefit.reporting.table_files import write_csv, write_csv_pieces
from needlefit.studies import columnar, parquet_reader
from needlefit.studies.columnar import (
    ColumnarFrames,
    iterate_pieces,
    list_columns,
    open_files,
    read_columns,
    store_files,
    write_frames,
)

parquet = pytest.importorskip("pyarrow.parquet")

COLUMNS = {"fits": ("dataset", "insertions", "value", "at_bound"), "failures": ("dataset", "note")}
TYPES = {"insertions": "int64", "value": "float64", "at_bound": "bool"}
VALUES = {"a": (1 / 3, math.nan), "b": (), "c": (math.inf, -0.0, 1e-300)}


def make_row(name, value):
    return {"dataset": name, "insertions": 2, "value": value, "at_bound": value > 1}


PARTS = [{"fits": [make_row(name, one) for one in values], "failures": []} for name, values in VALUES.items()]


def make_frames():
    return write_frames(TYPES, iter(PARTS), COLUMNS)


def in_memory():
    return pd.DataFrame([row for part in PARTS for row in part["fits"]])


@pytest.mark.parametrize(("least", "groups"), [(1, [2, 3]), (3, [5]), (1000, [5])])
def test_row_groups_hold_whole_parts_that_have_rows(monkeypatch, least, groups):
    monkeypatch.setattr(columnar, "MIN_GROUP_ROWS", least)
    frames = make_frames()
    stored = parquet.ParquetFile(frames.files["fits"].path).metadata
    assert [stored.row_group(n).num_rows for n in range(stored.num_row_groups)] == groups
    for size in (1, 1000):
        monkeypatch.setattr(parquet_reader, "MAX_PIECE_ROWS", size)
        pieces = [len(piece) for piece in iterate_pieces(frames, "fits")]
        assert pieces == (groups if size == 1 else [5])
        assert list(frames["fits"]["dataset"]) == ["a", "a", "c", "c", "c"]


def test_a_frame_of_a_file_is_that_in_memory():
    frames = make_frames()
    assert list(frames) == ["fits", "failures"] and list_columns(frames, "fits") == list(COLUMNS["fits"])
    pd.testing.assert_frame_equal(frames["fits"], in_memory(), check_exact=True)
    pd.testing.assert_frame_equal(pickle.loads(pickle.dumps(frames))["fits"], in_memory())
    some = read_columns(frames, "fits", ("value", "dataset"))
    assert some["dataset"].cat.categories.tolist() == ["a", "c"]
    assert read_columns({"fits": in_memory()}, "fits", ("value", "dataset")).equals(
        some.astype({"dataset": in_memory()["dataset"].dtype})
    )


@pytest.mark.parametrize("least", [1, 1000])
def test_a_csv_of_pieces_has_the_bytes_of_a_whole_one(tmp_path, monkeypatch, least):
    monkeypatch.setattr(columnar, "MIN_GROUP_ROWS", least)
    frames = make_frames()
    for name in frames:
        write_csv_pieces(iterate_pieces(frames, name), tmp_path / "pieces.csv")
        write_csv(frames[name], tmp_path / "whole.csv")
        assert (tmp_path / "pieces.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert (tmp_path / "pieces.csv").read_text() == "dataset,note\n"
    write_csv(in_memory(), tmp_path / "whole.csv")
    assert (tmp_path / "whole.csv").read_text().splitlines()[1:3] == ["a,2,0.33333333,False", "a,2,,False"]


def test_temporary_files_go_with_their_frames_and_with_a_task_that_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    frames = make_frames()
    assert len(list(tmp_path.iterdir())) == 1
    del frames
    assert list(tmp_path.iterdir()) == []

    def fail():
        yield PARTS[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_frames(TYPES, fail(), COLUMNS)
    gc.collect()
    assert list(tmp_path.iterdir()) == []


def test_stored_files_are_opened_by_their_names(tmp_path, monkeypatch):
    names = store_files(make_frames(), tmp_path)
    assert "fits" in names and ColumnarFrames(open_files(tmp_path, names))["fits"].equals(in_memory())
    assert store_files({"fits": in_memory()}, tmp_path) == []
    monkeypatch.setattr(columnar, "find_spec", lambda name: None)
    assert open_files(tmp_path, ()) == {}  # of other kinds of study
    with pytest.raises(ConfigError):
        open_files(tmp_path, names)
    monkeypatch.undo()
    (tmp_path / "fits.parquet").unlink()
    with pytest.raises(DataError, match=re.escape("fits.parquet")):
        open_files(tmp_path, names)


def test_a_damaged_page_is_an_error_that_names_the_file(tmp_path):
    """It is read in a sandbox."""
    store_files(make_frames(), tmp_path)
    path = tmp_path / "fits.parquet"
    whole = path.read_bytes()
    refused = 0
    for begin in range(4, len(whole) - 8, len(whole) // 12):
        path.write_bytes(whole[:begin] + bytes(24) + whole[begin + 24 :])
        frames = ColumnarFrames(open_files(tmp_path, ["fits"]))
        try:
            assert len(frames["fits"]) <= 5
        except DataError as error:
            assert error.where == str(path)
            refused += 1
    assert refused >= 6
