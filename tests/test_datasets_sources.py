"""Other people's files: long tables, MATLAB, templates, and the public stereo shapes where they lie."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from test_datasets import CURVE, SURFACES, record, row

from needlefit.datasets.formats.mat import read_curves
from needlefit.datasets.formats.mrk_json import CurveStyle, write_mrk_json
from needlefit.datasets.markups import Markups
from needlefit.datasets.noise import estimate_noise_floor
from needlefit.datasets.read import check, read
from needlefit.datasets.template import write_template
from needlefit.datasets.write import write_dataset
from needlefit.errors import ConfigError, DataError

SHIPPED = Path(__file__).parent.parent / "data"

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
    shapes(tmp_path / "lab-a", [1, 2])
    shapes(tmp_path / "lab-b", [3])
    return tmp_path / "dataset.toml"


def test_a_long_table_is_read_through_its_mapping(long):
    dataset = read(long)
    assert [i.id for i in dataset.insertions] == ["hole1_50", "hole2_50", "hole3_50"]
    assert [i.specimen for i in dataset.insertions] == ["1", "2", "3"]
    first = dataset.insertions[0]
    found = dataset.pose, dataset.drop_proximal, first.depth, first.pose_source
    assert found == ("free", 10.0, 50.0, "none")
    np.testing.assert_allclose(first.planar, CURVE[:, :2], atol=1e-3)  # x is the tangent at the entry
    assert first.sequence == (1,)
    path = long.parent / "lab-a" / "shapes.csv"
    whole = path.read_text()
    lines = whole.split("\n")
    lines[129] = "2,50,nan,0,0"
    path.write_text("\n".join(lines))
    [fault] = check(long)
    assert fault.where == f"{path}:130" and "u is 'nan'" in fault.what
    path.write_text(whole)
    shapes(long.parent / "lab-c", [2])
    [fault] = check(long)
    [fault] = check(long)
    assert "hole2_50 " in fault.what and "folder" in fault.what


def test_a_mapped_column_must_exist_and_be_constant(long):
    long.write_text(LONG.replace('specimen = "hole"', 'specimen = "piece"'))
    assert {"`piece`" in fault.what for fault in check(long)} == {True}
    long.write_text(LONG.replace('specimen = "hole"', 'specimen = "w"'))
    assert any("`w`" in fault.what and "hole1_50" in fault.what for fault in check(long))
    for field in ("{length}", "{depth.real}", "{depth:9}"):
        long.write_text(LONG.replace("{depth}", field))
        assert all("id_template" in fault.what for fault in check(long)) and check(long)
    long.write_text(LONG.replace("{depth}", "{depth}}"))
    assert {fault.what for fault in check(long)} >= {"id is 'hole1_50}'"}


def test_missing_data_is_reported_with_its_acquisition(long, monkeypatch):
    monkeypatch.setenv("NEEDLEFIT_TEST_DATA", str(long.parent / "elsewhere"))
    with pytest.raises(DataError, match=r"elsewhere[\s\S]*ask the tests"):
        read(long)
    monkeypatch.delenv("NEEDLEFIT_TEST_DATA")
    with pytest.raises(DataError, match=r"NEEDLEFIT_TEST_DATA[\s\S]*ask the tests"):
        read(long)


def test_free_shapes_have_a_noise_floor_after_alignment(long):
    """A correlated length much longer than the shape moves it as a whole, which alignment undoes."""
    for length, low, high in ((1e6, 0.0, 0.005), (5.0, 0.05, 0.15)):
        long.write_text(LONG + f"[noise]\ncorrelated_sd_mm = 0.1\ncorrelation_length_mm = {length}\n")
        dataset = read(long)
        floor = estimate_noise_floor(dataset, dataset.insertions[0], np.random.default_rng(2))
        assert low < floor["ipe_mean_mm"] < high


def test_matlab_centrelines_structs_and_cells_are_read(tmp_path):
    (tmp_path / "centerlines").mkdir(parents=True)
    file = write_dataset(
        tmp_path, record(), [row("a", "given", layers=2)], {"a": CURVE}, SURFACES, checksums=False
    )
    planar = read(file).insertions[0].planar
    (tmp_path / "centerlines" / "a.csv").unlink()
    savemat(tmp_path / "centerlines" / "a.mat", {"needle": CURVE.round(4), "note": "a text", "rate": 3.0})
    file.write_text(file.read_text().replace("{id}.csv", "{id}.mat"))
    np.testing.assert_array_equal(read(file).insertions[0].planar, planar)
    cells = np.empty(2, dtype=object)
    cells[:] = [CURVE, 2 * CURVE]
    savemat(tmp_path / "old.mat", {"run": {"shape": CURVE, "depth": 50.0}, "all": cells})
    curves = read_curves(tmp_path / "old.mat")
    assert sorted(curves) == ["all_1", "all_2", "run_shape"]
    np.testing.assert_array_equal(curves["all_2"].values, 2 * CURVE)
    with h5py.File(tmp_path / "new.mat", "w") as new:  # version 7.3 is HDF5, its matrices turned
        new["x"] = CURVE.T
        new["run/shape"] = 3 * CURVE.T
        new["#refs#/a"] = 2 * CURVE.T
        new.create_dataset("all", data=[[new["#refs#/a"].ref]], dtype=h5py.ref_dtype)
    curves = read_curves(tmp_path / "new.mat")
    assert sorted(curves) == ["all_1", "run_shape", "x"]
    np.testing.assert_array_equal(curves["run_shape"].values, 3 * CURVE)


@pytest.mark.sweep
def test_matlab_faults(tmp_path):
    file = write_dataset(
        tmp_path, record(), [row("a", "given", layers=2)], {"a": CURVE}, SURFACES, checksums=False
    )
    file.write_text(file.read_text().replace("{id}.csv", "{id}.mat"))
    path = tmp_path / "centerlines" / "a.mat"

    def fault():
        [only] = check(file)
        assert only.where.startswith(str(path))
        return only.what

    assert "no such file" in fault()
    path.write_bytes(b"nothing of MATLAB's, but long enough to look at" * 10)
    assert "cannot be read" in fault()
    savemat(path, {"x": np.zeros((5, 2))})
    assert fault().endswith(" x")
    savemat(path, {"x": CURVE, "y": CURVE})
    assert "holds 2 curves: x, y" in fault()
    broken = CURVE.copy()
    broken[4, 1] = np.nan
    savemat(path, {"x": broken})
    assert "NaN" in fault()
    assert check(file)[0].where.endswith("point 5")


def test_a_template_passes_check_and_may_begin_with_centrelines(tmp_path):
    file = write_template(tmp_path / "mine")
    assert check(tmp_path / "mine") == []
    dataset = read(file)
    assert dataset.origin == "synthetic" and "made-up" in file.read_text()
    assert [i.sequence for i in dataset.insertions] == [(1, 2), (1, 2)]
    with pytest.raises(ConfigError, match="exists already"):
        write_template(tmp_path / "mine")
    lines = [f"{name},{x},{y},{z}" for name in ("first run", "r2") for x, y, z in 3 * CURVE]
    (tmp_path / "runs.csv").write_text("\n".join(["id,x_mm,y_mm,z_mm", *lines]))
    savemat(tmp_path / "runs.mat", {"r1": CURVE, "r2": CURVE})
    from_csv = read(write_template(tmp_path / "a", tmp_path / "runs.csv"))
    assert [i.id for i in from_csv.insertions] == ["first_run", "r2"]
    assert from_csv.pose == "free" and from_csv.needle.length > from_csv.insertions[0].depth > 149
    assert [i.id for i in read(write_template(tmp_path / "b", tmp_path / "runs.mat")).insertions] == [
        "r1",
        "r2",
    ]


def test_a_template_from_faulty_centrelines_lists_the_faults(tmp_path):
    (tmp_path / "c.csv").write_text(
        "x_mm,y_mm,z_mm\n" + "".join(f"{x},{y},{z}\n" for x, y, z in CURVE / 1000)
    )
    with pytest.raises(DataError, match="metres"):
        write_template(tmp_path / "c", tmp_path / "c.csv")
    (tmp_path / "d.csv").write_text("x,y\n1,2\n")
    with pytest.raises(DataError, match="`x_mm` is missing"):
        write_template(tmp_path / "d", tmp_path / "d.csv")
    with pytest.raises(DataError, match="ending"):
        write_template(tmp_path / "e", tmp_path / "e.xlsx")


def long_table(path, header, curves):
    lines = [f"{name},{x},{y},{z}" for name, curve in curves.items() for x, y, z in curve]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def test_a_failed_template_leaves_nothing_and_names_the_source(tmp_path):
    source = long_table(
        tmp_path / "runs.csv", "id,x_mm,y_mm,z_mm", {"good": CURVE, "bad": CURVE[::-1] / 1000}
    )
    with pytest.raises(DataError, match="bad: depth_mm") as error:
        write_template(tmp_path / "mine", source)
    assert f"{source}:103" in str(error.value)  # one header line, 101 good points
    folded = CURVE[[*range(50), 51, 50, *range(52, 101)]]
    long_table(source, "id,x_mm,y_mm,z_mm", {"good": CURVE, "bad": folded})
    with pytest.raises(DataError, match="curve bad ") as error:
        write_template(tmp_path / "mine", source)
    assert f"{source}:154" in str(error.value)  # the fold is the 52nd point of the second curve
    savemat(tmp_path / "runs.mat", {"bad": CURVE * [1, np.nan, 1]})
    with pytest.raises(DataError, match=r"runs\.mat, point 1: curve bad .*\b101\b"):
        write_template(tmp_path / "mine", tmp_path / "runs.mat")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["runs.csv", "runs.mat"]


def test_a_template_lists_what_it_reads_and_ignores(tmp_path):
    notes = []
    source = long_table(tmp_path / "runs.csv", "run,x_mm,y_mm,z_mm", {"1": CURVE})
    dataset = read(write_template(tmp_path / "mine", source, notes.append))
    assert [insertion.id for insertion in dataset.insertions] == ["runs"]
    assert len(notes) == 2 and all(note.startswith(f"{source}: ") for note in notes)
    assert "`run`" in notes[0] and "`id`" in notes[1] and "101 rows" in notes[1]
    for path in (source, tmp_path / "none.csv", tmp_path / "e.xlsx"):
        source.write_text("x,y,z\n1,2,3\n")
        with pytest.raises(DataError) as error:
            write_template(tmp_path / "other", path)
        assert str(path) in str(error.value)
        assert "--from reads" in str(error.value) or "check the path" in error.value.fix


def test_a_template_keeps_deviations_and_reports_changed_ids(tmp_path):
    source = tmp_path / "runs.csv"
    lines = [f"{x},{y},{z},0.25" for x, y, z in CURVE]
    source.write_text("\n".join(["x_mm,y_mm,z_mm,sd_mm", *lines]) + "\n")
    np.testing.assert_array_equal(read(write_template(tmp_path / "mine", source)).insertions[0].sd, 0.25)
    tmp_path /= "b"
    tmp_path.mkdir()
    source = long_table(tmp_path / "runs.csv", "id,x_mm,y_mm,z_mm", {"a b": CURVE, "c": CURVE})
    remarks: list[str] = []
    file = write_template(tmp_path / "mine", source, remarks.append)
    assert [one.id for one in read(file).insertions] == ["a_b", "c"]
    assert len(remarks) == 1 and "a_b" in remarks[0]


def test_a_curve_of_few_points_or_another_s_name_is_no_template(tmp_path):
    source = long_table(tmp_path / "runs.csv", "id,x_mm,y_mm,z_mm", {"a": CURVE, "b": CURVE[:1]})
    with pytest.raises(DataError, match=r"curve b .*\b1 points") as error:
        write_template(tmp_path / "mine", source)
    assert error.value.where == f"{source}:103"
    source = long_table(tmp_path / "runs.csv", "id,x_mm,y_mm,z_mm", {"a b": CURVE, "a_b": CURVE})
    with pytest.raises(DataError, match="'a_b' becomes a_b, as another"):
        write_template(tmp_path / "mine", source)


@pytest.mark.parametrize("name", ["=1+1", "+a", "-a", "@a", "a\u202eb", "\uff1da", "a\x07", " =a"])
@pytest.mark.parametrize("ending", [".csv", ".mrk.json", ".fcsv"])
def test_unsafe_names_of_curves_are_refused(name, ending, tmp_path):
    source = tmp_path / f"runs{ending}"
    if ending == ".csv":
        long_table(source, "id,x_mm,y_mm,z_mm", {name: CURVE})
    elif ending == ".mrk.json":
        look = CurveStyle((0.0, 0.0, 0.0), 1.0)
        write_mrk_json(source, [(Markups(source, name, "Curve", ("",) * len(CURVE), CURVE), look)])
    else:
        source = tmp_path / f"{name}.fcsv"
        rows = "".join(f"{n},{x},{y},{z},0,0,0,1,1,1,0,p,,\n" for n, (x, y, z) in enumerate(CURVE))
        source.write_text(f"# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n{rows}")
    with pytest.raises(DataError) as error:
        write_template(tmp_path / "mine", source)
    assert "refused" in error.value.what or "control" in str(error.value)
    assert not (tmp_path / "mine").exists()


@pytest.mark.skipif("NEEDLEFIT_REAL_DATA" not in os.environ, reason="NEEDLEFIT_REAL_DATA is not set")
def test_the_public_stereo_shapes():
    dataset = read(SHIPPED / "stereo_shapes")
    depths = {insertion.depth for insertion in dataset.insertions}
    assert depths == {105.0, 110.0, 115.0, 120.0}
    assert len(dataset.insertions) == 4 * len({i.specimen for i in dataset.insertions}) >= 24
    assert (dataset.needle.length, dataset.needle.flexural_rigidity) == (200.0, 6441.0)
    for insertion in dataset.insertions:
        assert np.sqrt(np.mean(insertion.out_of_plane**2)) < 0.31  # the source's greatest is 0.3
        assert 2 < insertion.deflection < 20


def test_missing_public_stereo_shapes_name_their_source(monkeypatch):
    monkeypatch.delenv("NEEDLEFIT_REAL_DATA", raising=False)
    [fault] = check(SHIPPED / "stereo_shapes")
    assert "not set" in fault.what and "dlezcan1" not in fault.what and "shapes_planar.csv" in fault.fix
