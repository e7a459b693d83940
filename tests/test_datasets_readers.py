"""Readers on anything: a table, or an error that names the place; never another exception."""

import numpy as np
import pytest
from pytest import approx
from refusals import refusal
from test_datasets import block, without_checksums
from test_datasets_faults import add_columns, cell
from track_cases import DEPTH, GUIDE, HEAD, TOML, measured, track, written

from needlefit.datasets.formats.csv import read_table
from needlefit.datasets.read import check, inspect, read, read_shapes
from needlefit.datasets.select import select_insertions
from needlefit.errors import ConfigError, DataError
from needlefit.mechanics.needle import Needle
from needlefit.schemas.study import SelectionRecord

SECRET = [
    "root:x:0:0:root:/root:/bin/bash\nuser:x:1:1:,,,:/home:/bin/sh\n",
    "hunter2\ncorrect horse\n",
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
    assert found and not any(word in text for word in ("hunter2", "x:0", "token"))


@pytest.mark.parametrize(
    "content",
    ["a" + "," * 900 + "\n" + "1\n" * 5000, 'a,b\n1,"' + "x" * 200_000 + '"\n', "x" * 70 * 2**20],
    ids=["cells", "field", "size"],
)
def test_a_table_has_bounds(tmp_path, content):
    path = tmp_path / "t.csv"
    path.write_text(content)
    found = refusal(DataError, "", read_table, path)
    assert found.where.startswith(str(path)) and len(str(found)) < 1000


# ---- tip tracks: what is read, and the errors of faulty tables


@pytest.fixture(scope="module")
def runs():
    return [measured(track("rest", np.zeros(len(DEPTH)))), measured(track("moved", GUIDE))]


def table(folder):
    return folder / "steps.csv"


def test_runs_count_from_first_contact_and_an_invalid_reading_leaves_one_out(tmp_path, runs):
    dataset = read(written(tmp_path, runs))
    assert [one.id for one in dataset.insertions] == ["rest", "moved"]
    rest, moved = dataset.insertions
    assert moved.guide.depths == approx(DEPTH) and moved.guide.y == approx(GUIDE)
    assert (rest.guided, moved.guided, moved.side, moved.sequence) == (False, True, 1, (1,))
    assert moved.points == approx(runs[1].points, abs=1e-5) and moved.headings == ()
    assert (moved.observation, moved.directions) == ("tip_track", 1)
    assert check(tmp_path) == [] and dataset.noise.point_sd == 0.02
    folder = written(tmp_path, runs)
    cell("steps.csv", 20, ok="0")(folder)
    dataset = read(folder)
    assert [one.id for one in dataset.insertions] == ["rest"]
    (remark,) = dataset.remarks
    assert all(part in remark for part in ("moved", "1 of its 13 readings", "26 mm"))


@pytest.mark.parametrize(
    ("line", "cells", "expected"),
    [
        (4, {"at_mm": "2.0"}, r"steps.csv:4: run rest .*5\.7 .* 2 mm"),
        (4, {"x_mm": "left"}, r"steps.csv:4: x_mm .*'left'"),
        (14, {"at_mm": "60700"}, r"steps.csv:14: .*60644\.3 mm"),
        (14, {"x_mm": "60"}, r"run rest deflects 60 mm on 60 mm"),
        (2, {"phantom": "wax"}, r"run rest .*'wax'"),
    ],
)
def test_faults_name_line_and_cell(tmp_path, runs, line, cells, expected):
    folder = written(tmp_path, runs)
    cell("steps.csv", line, **cells)(folder)
    refusal(DataError, expected, read, folder)


def test_missing_columns_unknown_names_and_few_readings_are_refused(tmp_path, runs):
    folder = written(tmp_path / "a", runs, TOML.replace('"stage_mm"', '"stage"'))
    refusal(DataError, "`stage`", read, folder)
    folder = written(tmp_path / "b", runs, TOML.replace("guide_mm =", "template_mm ="))
    refusal(DataError, "template_mm", read, folder)
    folder = written(tmp_path / "c", runs)
    lines = table(folder).read_text().splitlines()
    table(folder).write_text("\n".join(lines[:5]) + "\n")
    refusal(DataError, r"run rest .*4 readings", read, folder)


def test_each_run_has_its_needle(tmp_path, runs):
    thin = "[needles.22G]\nlength_mm = 150.0\nflexural_rigidity_nmm2 = 2e3\n"
    folder = written(tmp_path, runs, f"{TOML}\n{thin}")
    add_columns("steps.csv", needle="")(folder)
    for line in range(2, 15):
        cell("steps.csv", line, needle="22G")(folder)
    rest, moved = read(folder).insertions
    assert rest.needle == Needle(150.0, 2e3, name="22G")
    assert moved.needle == Needle(200.0, 2.5e4, name="needle")
    cell("steps.csv", 4, needle="")(folder)
    refusal(DataError, "steps.csv:4: .*run rest .*'22G' to ''", read, folder)
    cell("steps.csv", 2, needle="25G")(folder)
    assert "steps.csv:2: needle '25G' is unknown" in "\n".join(map(str, check(folder)))


def test_selections_and_layers_of_tracks(tmp_path, runs):
    folder = written(tmp_path, runs, TOML + "layers = [1, 2]\n")
    assert "boundaries_mm" in str(check(folder)[0])
    refusal(DataError, "tip tracks", lambda: read_shapes(written(tmp_path, runs)))
    dataset = read(written(tmp_path, runs))
    assert [one.id for one in select_insertions(dataset, SelectionRecord(guided=True))] == ["moved"]
    with pytest.raises(ConfigError, match="insertion lost"):
        select_insertions(dataset, SelectionRecord(insertions=("lost",)))
    with pytest.raises(ConfigError, match="dataset mine"):
        select_insertions(dataset, SelectionRecord(insertions=("rest",), guided=True))


@pytest.mark.parametrize(("scatter", "count"), [(0.001, 1), (0.02, 0), (0.4, 1)])
def test_readings_that_scatter_more_or_less_than_their_stated_noise_contradict_it(tmp_path, scatter, count):
    depth = np.arange(0.0, 62.0, 2.0)
    tip = 1e-3 * depth**2 + np.random.default_rng(2).normal(0.0, scatter, len(depth))
    rows = [f"r,gel,{d},{x:.5f},0,1\n" for d, x in zip(depth, tip, strict=True)]
    (tmp_path / "steps.csv").write_text(HEAD + "".join(rows))
    (tmp_path / "dataset.toml").write_text(TOML)
    found = inspect(tmp_path)
    assert not found.faults and [one.kind for one in found.warnings].count("noise") == count


@pytest.mark.parametrize("seed", [2, 3])
def test_two_runs_with_the_same_readings_are_copies(tmp_path, seed):
    depth, rows = np.arange(0.0, 62.0, 2.0), ""
    for run, noise in (("r", 2), ("s", seed)):
        tip = 1e-3 * depth**2 + np.random.default_rng(noise).normal(0.0, 0.02, len(depth))
        rows += "".join(f"{run},gel,{d},{x:.5f},0,1\n" for d, x in zip(depth, tip, strict=True))
    (tmp_path / "steps.csv").write_text(HEAD + rows)
    (tmp_path / "dataset.toml").write_text(TOML)
    copies = [one.insertions for one in inspect(tmp_path).warnings if one.kind == "copy"]
    assert copies == ([("s", "r")] if seed == 2 else [])
