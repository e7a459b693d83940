"""A dataset written and read again is the same; known layers, planes, selections and noise come out."""

import dataclasses
import math
import tomllib

import numpy as np
import pytest
from made_again import read_files
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from refusals import refusal
from synthetic.design import make_cylinder

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.insertion import Noise
from needlefit.datasets.noise import draw_point_noise, estimate_noise_floor
from needlefit.datasets.read import check, read
from needlefit.datasets.select import select_insertions
from needlefit.datasets.write import write_dataset
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import make_sheet
from needlefit.mechanics.needle import Needle
from needlefit.schemas.dataset import DatasetRecord
from needlefit.schemas.study import SelectionRecord

BLOCK = """
schema = 1
name = "block"
origin = "synthetic"
license = "CC0-1.0"
source = "made up for the tests"
needle = { length_mm = 150.0, outer_diameter_mm = 1.27, youngs_modulus_gpa = 80.0 }
insertions.file = "insertions.csv"
centerlines.pattern = "centerlines/{id}.csv"
noise.registration_mean_mm = 0.19
media.given.boundaries_mm = [20.0, 50.5, 70.0]

[[media.block.surfaces]]
file = "layers/sheet.stl"
kind = "sheet"
into = 2

[[media.block.surfaces]]
file = "layers/core.stl"
kind = "solid"
into = 3
"""


def record(**changes):
    return DatasetRecord.model_validate(tomllib.loads(BLOCK) | changes)


SURFACES = {
    "layers/sheet.stl": make_sheet("sheet", (20, 0, 0), (1, 0, 0), 120, into=2),
    "layers/core.stl": make_cylinder("core", ((40, 0, -40), (40, 0, 40)), 5.0, into=3, facets=192),
}

X = np.linspace(0, 50, 101)
CURVE = np.column_stack([X, 4e-4 * X**2, 0 * X])  # bends toward +y, 1 mm at 50 mm


def row(name, medium="block", **changes):
    given = {
        "layers": 4,
        "depth": 50.0,
        "entry": np.zeros(3),
        "direction": np.array([1.0, 0, 0]),
        "pose_source": "stage",
    }
    return InsertionRow(name, medium, **(given | changes))


def block(folder, **changes):
    rows = [
        row("a", specimen="one"),
        row("b", medium="given", layers=2, specimen="two", layers_alternative=3, guide_distance=30.0),
        row("c", medium="given", layers=2, depth=50.0, specimen="two", bevel=np.array([0, -1.0, 0]), side=-1),
    ]
    return write_dataset(folder, record(**changes), rows, dict.fromkeys("abc", CURVE), SURFACES)


def reread(folder, *rows, curve=CURVE, surfaces=SURFACES, **changes):
    """Write insertions of one curve as a dataset, and read it."""
    curves = dict.fromkeys((one.id for one in rows), curve)
    return read(write_dataset(folder, record(**changes), rows, curves, surfaces))


def write_mine(folder):
    """Write two needles, `example1` and `example2`, through one boundary; return the file."""
    tables = record(name="mine", media={"medium1": {"boundaries_mm": [20.0]}}, noise={"point_sd_mm": 0.1})
    curves = {f"example{n}": CURVE * [1, n, 1] for n in (1, 2)}
    rows = [row(name, "medium1", layers=2, bevel=np.array([0, 1.0, 0])) for name in curves]
    return write_dataset(folder, tables, rows, curves, {}, checksums=False)


def test_a_written_dataset_is_read_back(tmp_path):
    dataset = read(block(tmp_path))
    assert check(tmp_path) == []
    a, b, c = dataset.insertions
    found = dataset.name, dataset.origin, dataset.pose, dataset.noise.registration_mean
    assert found == ("block", "synthetic", "known", 0.19)
    assert dataset.insertions[0].needle.flexural_rigidity == approx(1.0216e4, rel=1e-4)
    assert (a.specimen, a.layers, a.layers_alternative, a.guide_distance) == ("one", 4, 4, None)
    assert (b.specimen, b.layers, b.layers_alternative, b.guide_distance) == ("two", 2, 3, 30.0)
    assert_allclose(a.centerline, CURVE, atol=0.5e-4)
    assert_allclose(a.points[:, :2], CURVE[:, :2], atol=1e-4)
    assert a.deflection == approx(1.0)
    # Along x the sheet lies at 20; the cylinder about (40, y, z) of radius 5 from 35 to 45.
    assert a.sequence == (1, 2, 3, 2)
    y = 4e-4 * 40**2
    half = math.sqrt(25 - y**2)
    assert a.boundaries == approx([20, 40 - half, 40 + half], abs=0.03)
    assert b.sequence == (1, 2) and b.boundaries.tolist() == [20.0]
    assert_allclose(b.frame.rotation[:, 1], [0, 1, 0], atol=1e-6)
    assert_allclose(c.frame.rotation[:, 1], [0, -1, 0], atol=1e-6)
    assert c.points[-1, 1] == approx(-1.0)
    assert b.deflection == c.deflection == approx(1.0)  # both toward the bevel


def test_what_an_insertion_has_for_itself_is_written_and_read(tmp_path):
    twisted = CURVE + np.column_stack([0 * X, 0 * X, 0.3 * np.sin(X / 8)])
    (a,) = reread(tmp_path, row("a", bevel=np.array([0, 1.0, 0])), curve=twisted).insertions
    assert_allclose(a.points[:, 2], 0.3 * np.sin(X / 8), atol=1e-4)
    # Moving needle and pose together changes nothing in C.
    c, s = math.cos(0.4), math.sin(0.4)
    turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    shift = np.array([3.0, -5.0, 12.0])
    moved = row("a", "given", layers=2, entry=shift, direction=turn[:, 0])
    (a,) = reread(tmp_path, moved, curve=CURVE @ turn.T + shift).insertions
    assert_allclose(a.points[:, :2], CURVE[:, :2], atol=2e-4)
    stated = row("a", base_moved=-12.5, hole="first", observation_values={"force_n": -2e-6})
    a, b = reread(tmp_path, stated, row("b")).insertions
    assert (a.base_moved, b.base_moved) == (-12.5, 0.0)
    assert (a.hole, b.hole) == ("first", "") and a.observation_values == {"force_n": -2e-6}
    # A third of a turn about (1, 1, 1) takes x to y, y to z, z to x.
    turned = Frame(np.array([-0.5, 0, 0]), np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]))
    found = reread(tmp_path, row("a", "given", layers=2, patient=turned)).insertions[0].patient
    assert_allclose(found.to_world(np.eye(3)) - found.origin, np.eye(3)[[1, 2, 0]], atol=1e-8)


def test_each_insertion_has_its_needle_and_its_boundaries(tmp_path):
    thin = {"length_mm": 120.0, "flexural_rigidity_nmm2": 2e3, "note": "bent"}
    sheets = [{"file": f"layers/{n}.stl", "kind": "sheet", "into": n} for n in (2, 3)]
    media = {"sheets": {"surfaces": sheets}, "given": {"boundaries_mm": [20.0, 70.0]}}
    rows = [
        row("a", "sheets", layers=3),
        row("b", "given", layers=3, boundaries=(18.0, 36.25), needle="22G"),
        row("c", "given", layers=1, boundaries=(), needle="22G"),
        row("d", "given", layers=2),
    ]
    surfaces = {
        f"layers/{n}.stl": make_sheet(str(n), (x, 0, 0), (1, 0, 0), 120, into=n)
        for n, x in ((2, 18.0), (3, 36.25))
    }
    dataset = reread(tmp_path, *rows, surfaces=surfaces, media=media, needles={"22G": thin})
    a, b, c, d = dataset.insertions
    assert a.boundaries == approx(b.boundaries, abs=1e-4) and a.sequence == b.sequence == (1, 2, 3)
    assert (c.sequence, c.boundaries.tolist()) == ((1,), [])
    assert (d.sequence, d.boundaries.tolist()) == ((1, 2), [20.0])
    assert b.needle == c.needle == Needle(120.0, 2e3, name="22G")
    assert a.needle == d.needle == dataset.needles["needle"]
    assert (a.needle.outer_diameter, a.needle.length) == (1.27, 150.0)
    assert list(dataset.needles) == ["needle", "22G"] and dataset.notes == ("Needle 22G: bent",)


def test_the_same_data_gives_the_same_digest_and_additions_of_spreadsheets_are_ignored(tmp_path):
    one, two = block(tmp_path / "one"), block(tmp_path / "two")
    assert read_files(one.parent) == read_files(two.parent)
    assert read(one).digest == read(two).digest
    assert read(block(tmp_path / "three", title="another")).digest != read(one).digest
    # A byte order mark, CRLF, blank lines, spaces and quotes change nothing but the checksum.
    file = block(tmp_path)
    before = read(file)
    for path in (tmp_path / "insertions.csv", tmp_path / "centerlines" / "a.csv"):
        lines = path.read_text().splitlines()
        lines = [", ".join(f'"{cell}"' for cell in line.split(",")) for line in lines]
        path.write_bytes(("\ufeff" + "\r\n\r\n".join(lines) + "\r\n").encode())
    without_checksums(file)
    assert_array_equal(read(file).insertions[0].points, before.insertions[0].points)


def without_checksums(file):
    file.write_text(file.read_text().split("[checksums]")[0])


def test_selections_and_empty_ones(tmp_path):
    dataset = read(block(tmp_path))

    def ids(layer_count_rule="listed", **keys):
        return "".join(i.id for i in select_insertions(dataset, SelectionRecord(**keys), layer_count_rule))

    assert ids() == "abc"
    assert ids(medium="given") == ids(specimens=("two",)) == ids(layers=(2, 3)) == "bc"
    assert ids("alternative", layers=(2,)) == "c"
    assert ids("alternative", layers=(3,)) == "b"
    assert ids(insertions=("c", "a"), depth_max_mm=50.0, depth_min_mm=50.0) == "ac"
    for keys, words in [
        ({"medium": "gel"}, "medium gel"),
        ({"insertions": ("a", "z")}, "insertion z"),
        ({"specimens": ("three",)}, "specimen three"),
        ({"medium": "given", "depth_min_mm": 51.0}, "of its 3 insertions"),
    ]:
        with pytest.raises(ConfigError, match=words):
            select_insertions(dataset, SelectionRecord(**keys))


def test_noise_floors_of_a_shift_and_of_an_angle(tmp_path):
    # Of an isotropic shift of mean length m a plane shows m pi / 4, a curve cut at its entry m / 2.
    for begins, expected in [(0.5, math.pi / 4), (0.0, 1 / 2)]:
        dataset = read(block(tmp_path))
        insertion = dataset.insertions[0]
        insertion = dataclasses.replace(insertion, points=insertion.points + np.array([begins, 0.0, 0.0]))
        floor = estimate_noise_floor(dataset, insertion, default_rng(1), draws=1500)
        assert floor["te_mm"] == approx(0.19 * expected, rel=0.03)
        assert floor["ipe_mean_mm"] == approx(0.19 * expected, rel=0.03)
    # A turn of standard deviation q leaves q L sqrt(2 / pi) at the tip on average, half of it overall.
    turned = row("a", "given", layers=2, pose_angle_sd=0.01)
    dataset = reread(tmp_path, turned, noise={})
    floor = estimate_noise_floor(dataset, dataset.insertions[0], default_rng(1), draws=1500)
    assert floor["te_mm"] == approx(0.01 * 50 * math.sqrt(2 / math.pi), rel=0.05)
    assert floor["ipe_mean_mm"] == approx(floor["te_mm"] / 2, rel=0.01)
    # Where the entry is the first point a shift is taken off: half of the turn's error at the tip is left.
    turned = dataclasses.replace(turned, pose_source="first_point", pose_shift_sd=0.4)
    dataset = reread(tmp_path, turned, noise={})
    assert dataset.insertions[0].pose_source == "first_point"
    shifted = estimate_noise_floor(dataset, dataset.insertions[0], default_rng(1), draws=1500)
    assert shifted["te_mm"] == approx(floor["te_mm"] / 2, rel=0.03)
    dataset = read(block(tmp_path, noise={}))
    assert math.isnan(estimate_noise_floor(dataset, dataset.insertions[0], default_rng(1))["te_mm"])


def test_point_noise_has_the_stated_covariance():
    noise = Noise(point_sd=0.3, correlated_sd=0.4, correlation_length=2.0)
    drawn = draw_point_noise(np.arange(8.0), noise, default_rng(1), 20000)[:, :, 1]
    lag = np.abs(np.subtract.outer(np.arange(8), np.arange(8)))
    assert_allclose(np.cov(drawn.T), 0.16 * np.exp(-lag / 2) + 0.09 * np.eye(8), atol=0.01)


# ---- other people's files: long tables, MATLAB, templates, public data

LONG = """\
schema = 1
name = "long"
origin = "synthetic"
license = "CC0-1.0"
source = "made up for the tests"
how_to_get = "ask the tests"
root = "$NEEDLEFIT_TEST_DATA/lab-*"
frame = { pose = "free", drop_proximal_mm = 10.0 }
needle = { length_mm = 150.0, flexural_rigidity_nmm2 = 6000.0 }
media = { gel = {} }
[insertions]
id_template = "hole{hole}_{depth}"
columns = { specimen = "hole", depth_mm = "depth" }
constants = { medium = "gel", layers = 1 }
[centerlines]
file = "shapes.csv"
group_by = ["hole", "depth"]
columns = { x_mm = "u", y_mm = "w", z_mm = "out" }
"""


def shapes(folder, holes, depth=50):
    folder.mkdir()
    lines = [f"{h},{depth},{u:.4f},{w:.4f},{z:.4f}" for h in holes for u, w, z in CURVE]
    (folder / "shapes.csv").write_text("\n".join(["hole,depth,u,w,out", *lines]) + "\n")


@pytest.fixture
def long(tmp_path, monkeypatch):
    monkeypatch.setenv("NEEDLEFIT_TEST_DATA", str(tmp_path))
    (tmp_path / "dataset.toml").write_text(LONG)
    shapes(tmp_path / "lab-a", [1, 2, 3])
    return tmp_path / "dataset.toml"


def test_a_long_table_is_read_through_its_mapping(long):
    dataset = read(long)
    assert [i.id for i in dataset.insertions] == ["hole1_50", "hole2_50", "hole3_50"]
    assert [i.specimen for i in dataset.insertions] == ["1", "2", "3"]
    first = dataset.insertions[0]
    found = dataset.pose, dataset.drop_proximal, first.depth, first.pose_source
    assert found == ("free", 10.0, 50.0, "none")
    assert_allclose(first.points[:, :2], CURVE[:, :2], atol=1e-3)  # x is the tangent at the entry
    assert first.sequence == (1,)
    path = long.parent / "lab-a" / "shapes.csv"
    whole = path.read_text()
    lines = whole.split("\n")
    lines[129] = "2,50,nan,0,0"
    path.write_text("\n".join(lines))
    [fault] = check(long)
    assert fault.where == f"{path}:130" and "u is 'nan'" in fault.what
    path.write_text(whole)
    (long.parent / "lab-c").mkdir()
    [fault] = check(long)
    assert "2 folders" in fault.what and fault.where == str(long) and fault.fix


def test_a_mapped_column_must_exist_and_be_constant(long):
    long.write_text(LONG.replace('specimen = "hole"', 'specimen = "piece"'))
    assert {"`piece`" in fault.what for fault in check(long)} == {True}
    long.write_text(LONG.replace('specimen = "hole"', 'specimen = "w"'))
    assert any("`w`" in fault.what and "hole1_50" in fault.what for fault in check(long))


def test_missing_data_is_reported_with_its_acquisition(long, monkeypatch):
    monkeypatch.setenv("NEEDLEFIT_TEST_DATA", str(long.parent / "elsewhere"))
    refusal(DataError, r"elsewhere[\s\S]*ask the tests", read, long)
    monkeypatch.delenv("NEEDLEFIT_TEST_DATA")
    refusal(DataError, r"NEEDLEFIT_TEST_DATA[\s\S]*ask the tests", read, long)
