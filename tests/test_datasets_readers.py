"""Readers on anything: a table, or an error that names the place; never another exception."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refusal
from test_datasets import block, without_checksums

from needlefit.datasets.formats import mat
from needlefit.datasets.formats.csv import parse_numbers, read_table
from needlefit.datasets.read import check
from needlefit.errors import DataError
from needlefit.project import input_files

anything = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
finite = st.floats(-1e6, 1e6)


@given(
    st.binary(max_size=200)
    | st.text(max_size=200).map(str.encode)
    | st.text('a,1"\n;', max_size=60).map(str.encode)
)
@anything
def test_any_bytes_are_a_table_or_a_data_error(tmp_path, content):
    path = tmp_path / "any.csv"
    path.write_bytes(content)
    try:
        table = read_table(path)
    except DataError as error:
        assert error.where.startswith(str(path))
    else:
        assert len(table.cells) == len(table.lines) > 0


@given(st.lists(st.tuples(finite, finite, st.integers(0, 3)), min_size=1, max_size=20))
@anything
def test_numbers_and_lines_survive_whatever_blank_lines_stand_between(tmp_path, rows):
    path = tmp_path / "t.csv"
    text, lines = "a,b\n", []
    for a, b, blanks in rows:
        text += "\n" * blanks
        lines.append(text.count("\n") + 1)
        text += f"{a!r},{b!r}\n"
    path.write_text(text)
    table, found = read_table(path), []
    values = np.column_stack([parse_numbers(table, column, found) for column in "ab"])
    assert not found and table.lines.tolist() == lines
    np.testing.assert_allclose(values, [row[:2] for row in rows], rtol=1e-14)


@pytest.mark.parametrize("read", [mat.read_curves, input_files.read_text])
def test_every_reader_reports_an_unreadable_file_alike(tmp_path, read):
    error = refusal(DataError, "no such file", read, tmp_path / "gone")
    assert error.where == str(tmp_path / "gone")
    with pytest.raises(DataError, match="is a folder"):
        read(tmp_path)  # a folder


SECRET = [
    "root:x:0:0:root:/root:/bin/bash\nuser:x:1:1:,,,:/home:/bin/sh\n",
    "hunter2\ncorrect horse\n",
    "-----BEGIN KEY-----\nMIIEvQIBADANBg,kqhkiG9w0B\n",
    '{"token": "hunter2,x:0"}\n{"token": "x:0"}\n',
]


@pytest.mark.parametrize("name", ["insertions.csv", "centerlines/b.csv"])
@pytest.mark.parametrize("content", SECRET)
def test_the_content_of_a_foreign_file_is_not_printed(tmp_path, name, content):
    folder = tmp_path / "block"
    without_checksums(block(folder))
    (tmp_path / "secret").write_text(content)
    (folder / name).unlink()
    (folder / name).symlink_to(tmp_path / "secret")
    found = check(folder)
    text = "".join(f"{fault.where} {fault.what} {fault.expected} {fault.fix}" for fault in found)
    assert found and not any(word in text for word in ("hunter2", "x:0", "MIIE", "BEGIN", "token"))


@pytest.mark.parametrize(
    "content",
    [
        ",".join(f"c{n}" for n in range(2000)) + "\n",
        "a" + "," * 900 + "\n" + "1\n" * 5000,
        'a,b\n1,"' + "x" * 200_000 + '"\n',
        "x" * 70 * 2**20,
    ],
    ids=["columns", "cells", "field", "size"],
)
def test_a_table_has_bounds(tmp_path, content):
    path = tmp_path / "t.csv"
    path.write_text(content)
    found = refusal(DataError, "", read_table, path)
    assert found.where.startswith(str(path)) and len(str(found)) < 1000
