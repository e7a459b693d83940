"""Formats of points (MATLAB, JSON lines, markups, structure sets): what is read, and advice about others."""

import json
from pathlib import Path

import h5py
import import_cases
import numpy as np
import pytest
from import_cases import curves_of, prepare
from numpy.testing import assert_allclose
from pytest import approx
from refusals import refusal
from scipy.io import savemat

from needlefit.datasets.faults import as_error, merge_like
from needlefit.datasets.formats import find_format
from needlefit.datasets.importing.tables import read_structured
from needlefit.datasets.importing.writing import write_plan
from needlefit.errors import DataError

CASES = Path(__file__).with_name("imports")
CURVES = [import_cases.needle(n, 16 - n) for n in range(4)]
SIDES = [1.0, -1.0, 1.0, -1.0]


def cells(values):
    found = np.empty(len(values), dtype=object)
    found[:] = values
    return found


def padded(curves, filler, rows=18):
    """Return curves as a stack (N, 3, K)."""
    return np.dstack([np.vstack([one, np.full((rows - len(one), 3), filler)]) for one in curves])


def beside(axis, curves=CURVES, filler=np.nan, rows=18):
    """Return one coordinate of curves as a matrix with a column for each."""
    return padded(curves, filler, rows)[:, axis, :]


class Content:
    """The needles of a file as an import reads them, and the fields beside each."""

    def __init__(self, path, **stated):
        curves, draft = curves_of([path], **stated)
        self.names, self.curves = [*curves], [*curves.values()]
        self.unused = {what.removesuffix(" ignored") for what, _ in draft.unused}
        self.table = read_structured(path)
        self.units = {record.get("unit") for one in draft.tables for record in one["columns"].values()}


def content_of(folder, **variables):
    savemat(folder / "a.mat", variables)
    return Content(folder / "a.mat")


def assert_same(content, wanted=CURVES, factor=1.0):
    assert len(content.curves) == len(wanted)
    for one, points in zip(content.curves, wanted, strict=True):
        assert_allclose(one.line, factor * points, atol=1e-9)


def stated(content, key):
    """Return what a field of a file states of each needle."""
    column = content.table.find(key)
    return [*{row[0]: row[column] for row in content.table.rows}.values()]


def sides_of(content):
    return [one.stated["bevel_side"].text.removesuffix(".0") for one in content.curves]


# ---- MATLAB: one value for each needle, or one for all


def test_a_cell_of_version_7_3_beside_a_vector_has_a_side_for_each_needle():
    content = Content(CASES / "needles_v73.mat")
    assert content.names == [f"needles_{n}" for n in range(1, 7)]
    assert [len(one.line) for one in content.curves] == [10, 12, 14, 16, 18, 20]
    assert sides_of(content) == ["1", "-1"] * 3
    assert [one.length for one in content.curves] == approx(range(45, 105, 10), abs=0.3)


@pytest.mark.parametrize("container", ["cell", "stack"])
def test_as_many_values_as_curves_are_one_each(tmp_path, container):
    curves = CURVES if container == "cell" else [one[:12] for one in CURVES]
    needles = cells(curves) if container == "cell" else np.dstack(curves)
    content = content_of(
        tmp_path,
        needles=needles,
        side=np.array(SIDES)[:, None],
        name=cells(["a", "b", "c", "d"]),
        depth=cells([60.0, np.empty((0, 0)), 50.0, 45.0]),
        boundaries=np.array([[15.0, 30.0], [14.0, 29.0], [16.0, np.nan], [np.nan, np.nan]]),
        entry=np.arange(12.0).reshape(4, 3),
        gauge=18.0,
        temperatures=np.arange(3.0),
        forces=np.arange(30.0),
    )
    assert content.names == ["a", "b", "c", "d"]
    assert_same(content, curves)
    assert stated(content, "side") == ["1", "-1", "1", "-1"]
    assert stated(content, "depth") == ["60", "", "50", "45"]
    assert stated(content, "boundaries") == ["15, 30", "14, 29", "16", ""]
    assert stated(content, "entry") == ["0, 1, 2", "3, 4, 5", "6, 7, 8", "9, 10, 11"]
    assert stated(content, "gauge") == ["18"] * 4 and stated(content, "temperatures") == ["0, 1, 2"] * 4
    assert "variable forces" in content.unused


def test_rows_of_a_matrix_are_of_needles_only_where_their_numbers_agree(tmp_path):
    content = content_of(tmp_path, needles=cells(CURVES[:2]), path=CURVES[2], boundaries=[15.0, 30.0, 40.0])
    assert content.names == ["needles_1", "needles_2", "path"]
    assert stated(content, "boundaries") == ["15, 30, 40"] * 3


def test_fields_of_a_struct_beside_curves_are_stated_of_them(tmp_path):
    info = np.empty(4, dtype=[("bevel", object), ("block", object)])
    info[:] = [(side, f"b{n}") for n, side in enumerate(SIDES)]
    setup = {"gauge": 18.0, "modulus": "steel"}
    content = content_of(tmp_path, needles=cells(CURVES), info=info, setup=setup)
    assert sides_of(content) == ["1", "-1", "1", "-1"]
    assert stated(content, "block") == ["b0", "b1", "b2", "b3"]
    assert {(one.stated["diameter"].text, one.stated["modulus"].text) for one in content.curves} == {
        ("18", "steel")
    }


def test_a_modulus_without_a_unit_is_in_the_only_one_that_a_needle_has(tmp_path):
    """80 is GPa, 8e10 Pa, 200000 MPa."""
    for number, unit, gpa in ((80.0, "", 80.0), (8e10, "Pa", 80.0), (2e5, "MPa", 200.0)):
        file, words = tmp_path / f"{gpa}{unit}.mat", {"pose": "1,0,0"}
        savemat(file, {"needles": cells(CURVES), "rig": {"E": number, "OD": 1.27}})
        if unit:
            assert f"--set modulus.unit={unit}" in refusal(DataError, "modulus", prepare, [file], **words).fix
            words["modulus__unit"] = unit
        assert prepare([file], **words).plan.needle.youngs_modulus_gpa == approx(gpa)


def test_empty_cells_keep_the_values_of_the_others_in_their_places(tmp_path):
    needles = cells([CURVES[0], np.empty((0, 0)), CURVES[2], CURVES[3]])
    content = content_of(tmp_path, needles=needles, side=[1, -1, -1, 1], block=cells(["p", "q", "r"]))
    assert content.names == ["needles_1", "needles_3", "needles_4"]
    assert stated(content, "side") == ["1", "-1", "1"] and stated(content, "block") == ["p", "q", "r"]
    assert "variable needles_2" in content.unused


def test_empty_values_and_tables_of_version_7_3_are_no_numbers(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["curve"] = CURVES[0].T
        file["bevel"] = np.array([0, 0], dtype="u8")  # the size of a text without a letter
        file["bevel"].attrs["MATLAB_empty"] = 1
        file["T"] = np.array([[3707764736, 2, 1, 1, 1, 1]], dtype="u4")
        file["T"].attrs["MATLAB_object_decode"] = 3
    content = Content(tmp_path / "a.mat")
    assert stated(content, "bevel") == [""] and content.unused == {"variable T"}
    assert_same(content, CURVES[:1])


def test_a_value_that_stands_nearer_to_a_curve_counts_and_the_other_one_is_named(tmp_path):
    inner = {"points": CURVES[0], "depth": 60.0}
    content = content_of(tmp_path, n1=inner, depth=10.0, meta={"who": "me"}, more={"who": "you"})
    assert stated(content, "depth") == ["60"] and stated(content, "who") == ["me"]
    assert content.unused == {"column who", "variable depth", "variable more.who"}


# ---- padding


@pytest.mark.parametrize("filler", [np.nan, 0.0])
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 0, 2)])
def test_padding_of_stacks_is_removed_and_counted(tmp_path, filler, order):
    content = content_of(tmp_path, c=np.transpose(padded(CURVES, filler), order), side=SIDES)
    assert_same(content)
    assert sides_of(content) == ["1", "-1", "1", "-1"]
    (remark,) = content.unused
    assert f"{2 + 3 + 4 + 5} rows" in remark and "4 curves of c" in remark


def test_a_curve_that_is_one_point_shorter_than_the_longest_is_padded_too(tmp_path):
    assert_same(content_of(tmp_path, c=padded(CURVES, 0.0, rows=16)))


def test_a_point_at_the_origin_is_no_padding(tmp_path):
    backward = [one[::-1] - one[0] for one in CURVES]  # the entry is the last point, and the origin
    assert_same(
        content_of(tmp_path, c=np.dstack([one[-12:] for one in backward])), [b[-12:] for b in backward]
    )
    assert_same(content_of(tmp_path, c=padded(backward, 0.0, rows=16)), backward)


# ---- x, y and z


@pytest.mark.parametrize("filler", [np.nan, 0.0])
def test_matrices_of_x_y_and_z_have_a_column_for_each_needle(tmp_path, filler):
    axes = {axis: beside(n, filler=filler) for n, axis in enumerate("xyz")}
    content = content_of(tmp_path, **axes, side=SIDES)
    assert_same(content)
    assert content.names == [f"curve_{n}" for n in range(1, 5)]
    assert sides_of(content) == ["1", "-1", "1", "-1"]
    content = content_of(tmp_path, needles={"X": axes["x"], "Y": axes["y"], "side": SIDES})
    assert_same(content)
    assert content.names == [f"needles_{n}" for n in range(1, 5)]


def test_three_columns_of_x_and_y_are_three_needles_and_cells_of_vectors_too(tmp_path):
    assert_same(content_of(tmp_path, x=beside(0, CURVES[:3]), y=beside(1, CURVES[:3])), CURVES[:3])
    axes = {axis: cells([one[:, n] for one in CURVES]) for n, axis in enumerate("xyz")}
    assert_same(content_of(tmp_path, **axes))


def test_x_and_y_beside_other_curves_are_no_needle(tmp_path):
    for needles, wanted in ((cells(CURVES), CURVES), (CURVES[0], CURVES[:1])):
        content = content_of(tmp_path, needles=needles, x=np.arange(50.0), y=np.arange(50.0))
        assert_same(content, wanted)
        assert content.unused == {"variable x", "variable y"}


def table_fields():
    rows = np.concatenate(CURVES)
    names = [f"n{n}" for n, one in enumerate(CURVES, 1) for _ in one]
    sides = np.concatenate([[side] * len(one) for side, one in zip(SIDES, CURVES, strict=True)])
    return {"needle": cells(names), "bevel": sides, "x": rows[:, 0], "y": rows[:, 1], "z": rows[:, 2]}


@pytest.mark.parametrize("shape", ["vectors", "variables", "rows"])
def test_a_table_in_fields_is_read_as_a_table(tmp_path, shape):
    """As `table2struct` writes it, with and without `ToScalar`."""
    fields = table_fields()
    if shape == "rows":
        table = np.empty(len(fields["x"]), dtype=[(key, object) for key in fields])
        table[:] = [*zip(*fields.values(), strict=True)]
    content = content_of(
        tmp_path, **(fields if shape == "variables" else {"T": fields if shape == "vectors" else table})
    )
    assert content.names == ["n1", "n2", "n3", "n4"]
    assert_same(content)
    assert sides_of(content) == ["1", "-1"] * 2


# ---- units


@pytest.mark.parametrize(
    "variables",
    [
        {"needles": cells(CURVES), "unit": "cm"},
        {"needles": cells(CURVES), "meta": {"Units": "centimeter"}},
        {"needles_cm": cells(CURVES)},
        {"a": {"points_cm": CURVES[0]}, "b_cm": CURVES[1], "c_cm": CURVES[2], "d_cm": CURVES[3]},
        {f"{axis}_cm": beside(n) for n, axis in enumerate("xyz")},
        {"T": {f"{key}_cm" if key in ("x", "y", "z") else key: part for key, part in table_fields().items()}},
    ],
)
def test_a_field_or_a_name_states_the_unit(tmp_path, variables):
    content = content_of(tmp_path, **variables)
    assert "cm" in content.units
    assert_same(content, factor=10.0)


# ---- JSON lines


def test_json_lines_have_an_object_for_each_needle(tmp_path):
    content = Content(CASES / "shapes.jsonl")
    assert content.names == [f"n{n}" for n in range(1, 7)]
    assert [len(one.line) for one in content.curves] == [10, 12, 14, 16, 18, 20]
    assert sides_of(content) == ["1", "-1"] * 3
    assert "time" in content.table.headers or content.table.find("t") is not None
    rows = [
        {"needle": f"n{n}", "x": float(x), "y": float(y), "z": float(z)}
        for n, one in enumerate(CURVES)
        for x, y, z in one
    ]
    (tmp_path / "a.jsonl").write_text("\n".join(map(json.dumps, rows)))
    content = Content(tmp_path / "a.jsonl")
    assert content.names == ["n0", "n1", "n2", "n3"]
    assert_same(content)


def test_places_may_be_fields_of_fields_in_json(tmp_path):
    turn = {"x": 0.1, "y": 0.2, "z": 0.3, "w": 0.9}
    for n, curve in enumerate(CURVES):
        poses = [
            {
                "stamp": {"secs": k},
                "pose": {"position": dict(zip("xyz", point, strict=True)), "orientation": turn},
            }
            for k, point in enumerate(curve.tolist())
        ]
        (tmp_path / f"run{n}.jsonl").write_text("\n".join(map(json.dumps, poses)))
        content = Content(tmp_path / f"run{n}.jsonl", holds="shapes")
        assert content.names == [f"run{n}"]
        assert_allclose(content.curves[0].line, curve)
        assert "stamp.secs" in content.table.headers
    needles = {
        f"n{n}": {**dict(zip("xyz", one.T.tolist(), strict=True)), "side": 1} for n, one in enumerate(CURVES)
    }
    (tmp_path / "all.json").write_text(json.dumps(needles))
    content = Content(tmp_path / "all.json")
    assert content.names == ["n0", "n1", "n2", "n3"]
    assert_same(content)
    points = [{"entry": {"x": n, "y": 0, "z": 0}, "points": one.tolist()} for n, one in enumerate(CURVES)]
    (tmp_path / "points.json").write_text(json.dumps(points))
    assert len(read_structured(tmp_path / "points.json").rows) == sum(map(len, CURVES))


@pytest.mark.parametrize(
    ("text", "place"),
    [
        *(
            ('{"a": [1, 2]}\n{"a"', ":2"),
            ("", ""),
            ('{"points": [[1, 2, 3]]}', ""),
            ("[" * 500 + "]" * 500, ":1"),
        ),
        *(('{"n": 1' + "0" * 400 + ', "points": [[1, 2, 3], [1e999, 2]]}', ""), ('["a", null, true]', "")),
    ],
)
def test_bad_json_lines_are_refused(tmp_path, text, place):
    (tmp_path / "a.jsonl").write_text(text)
    assert refusal(DataError, "", prepare, [tmp_path / "a.jsonl"]).where.endswith(f"a.jsonl{place}")


# ---- markups


def test_labels_of_one_list_name_needles():
    content = Content(CASES / "labels.mrk.json")
    assert [(one.name, len(one.line)) for one in content.curves] == [("N1", 5), ("N2", 6), ("N3", 7)]
    assert [one.length for one in content.curves] == approx([40, 50, 60], abs=0.1)


@pytest.mark.parametrize(
    ("labels", "sizes"),
    [
        (["F-1", "F-2", "F-3", "F-4", "F-5", "F-6"], [6]),
        (["A 1", "A 2", "A 3", "B 1", "B 2", "B 3"], [3, 3]),
        (["N-1", "N-2", "N-3", "N-4", "N-5", "target-1"], [5, 1]),
        (["A-1", "A-2", "A-3", "B-4", "B-5", "B-6"], [6]),  # numbered as one needle
        (["10.0", "20.0", "30.0", "10.5", "20.5", "30.5"], [6]),
        (["A-1", "A-2", "A-3", "B-1", "B-2", "tip"], [6]),
        ([""] * 6, [6]),
    ],
)
@pytest.mark.parametrize("suffix", [".mrk.json", ".json", ".fcsv"])
def test_labels_are_grouped_only_where_they_name_needles(tmp_path, labels, sizes, suffix):
    file = tmp_path / f"F{suffix}"
    if suffix == ".fcsv":
        rows = [f"{n},{5 * n},0,0,0,0,0,1,1,1,0,{label},," for n, label in enumerate(labels)]
        file.write_text("\n".join(["# CoordinateSystem = LPS", *rows]))
    else:
        one = import_cases.markups("F", CURVES[0][:6], "Fiducial")
        for point, label in zip(one["controlPoints"], labels, strict=True):
            point["label"] = label
        file.write_text(json.dumps({"markups": [one]}))
    found, remarks = find_format(file).read_curves(file)
    assert [len(one.values) for one in found.values()] == sizes
    assert len(remarks) == (len(sizes) > 1)


# ---- what is not read, and advice that works in the file


def test_a_structure_set_names_the_package_that_reads_it(monkeypatch):
    monkeypatch.setattr("needlefit.datasets.formats.rtstruct.find_spec", lambda name: None)
    assert "needlefit[ct]" in refusal(DataError, "pydicom", prepare, [CASES / "needles_rs.dcm"]).fix


def write_faulty(folder, paths, **stated):
    (folder / "made").mkdir(exist_ok=True)
    prepared = prepare(paths, **stated)
    return refusal(
        DataError, "", write_plan, folder / "made", prepared.content, prepared.plan, prepared.mapping
    )


def test_faults_of_a_track_are_at_the_row_of_its_file(tmp_path):
    depths = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0]
    rows = [f"{name},{depth},{1e-3 * depth**2:.3f}" for name in "pq" for depth in depths]
    rows[9], rows[10] = rows[10], rows[9]
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["run,depth [mm],deflection [mm]", *rows]))
    error = write_faulty(tmp_path, [file], holds="tracks")
    assert error.where == f"{file}:12" and "tracks.csv" not in str(error)


# ---- many faults of one kind


def _note(where, what, expected="", fix=""):
    return DataError(what, where=where, expected=expected, fix=fix)


def test_faults_are_merged_by_file_and_kind():
    few = [_note(f"/d/a.csv:{n}", f"cell {n}", "a number", "fix it") for n in range(3)]
    many = [_note(f"/d/b.csv:{n}", f"cell {n}", "a number", "fix it") for n in range(30)]
    other = [_note(f"/d/b.csv:{n}", f"cell {n}", "a name", "fix it") for n in range(2)]
    merged = merge_like([*few, *many, *other])
    places = [*(f"/d/a.csv:{n}" for n in range(3)), "/d/b.csv:0", "/d/b.csv:0", "/d/b.csv:1"]
    assert [one.where for one in merged] == places and "29" in merged[3].what
    assert "has 35 faults" in as_error([*few, *many, *other], Path("/d")).what


def test_an_entry_of_one_point_in_an_array_of_structs_is_a_tip(tmp_path):
    array = np.zeros((1, 3), dtype=[("name", object), ("points", object)])
    for n, curve in enumerate((CURVES[0], CURVES[1], CURVES[2][-1:])):
        array[0, n] = (f"n{n}", curve)
    savemat(tmp_path / "needles.mat", {"needles": array})
    curves, _ = curves_of([tmp_path / "needles.mat"], unit="mm")
    assert [curve.kind.name for curve in curves.values()] == ["shapes", "shapes", "tips"]
    assert_allclose(curves["n2"].line, CURVES[2][-1:])


def test_vectors_as_long_as_the_points_beside_them_are_columns(tmp_path):
    depths = np.linspace(5.0, 60.0, len(CURVES[0]))
    runs = [{"tip": CURVES[0], "depth": depths[:, None], "bevel": side} for side in ("up", "down")]
    savemat(tmp_path / "runs.mat", {"run": runs})
    points, _ = find_format(tmp_path / "runs.mat").read_curves(tmp_path / "runs.mat")
    assert [[float(text) for text in curve.columns["depth"]] for curve in points.values()] == [
        pytest.approx(depths)
    ] * 2
    assert [curve.stated["bevel"] for curve in points.values()] == ["up", "down"]


def test_an_archive_of_numpy_is_read_as_a_matlab_file_unless_it_holds_objects(tmp_path):
    np.savez(tmp_path / "a.npz", **{f"n{n}": curve for n, curve in enumerate(CURVES)}, units="cm")
    curves, _ = curves_of([tmp_path / "a.npz"])
    for points, curve in zip(CURVES, curves.values(), strict=True):
        assert_allclose(curve.line, 10 * points, atol=1e-9)
    np.save(tmp_path / "needle.npy", np.stack([10 * CURVES[0]] * 2))
    curves, _ = curves_of([tmp_path / "needle.npy"], unit="mm")
    assert [*curves] == ["needle_1", "needle_2"]
    np.savez(tmp_path / "b.npz", needles=np.array([*CURVES, None], dtype=object))
    refusal(DataError, "", find_format(tmp_path / "b.npz").read_curves, tmp_path / "b.npz")


def test_matlab_arrays_of_two_columns_are_curves_in_a_plane(tmp_path):
    curve = np.column_stack([np.linspace(0.0, 40.0, 9), np.linspace(0.0, 2.0, 9) ** 2])
    savemat(tmp_path / "a.mat", {"Versuch": [{"Nr": n, "Punkte": curve[: 9 - n]} for n in range(2)]})
    curves, _ = find_format(tmp_path / "a.mat").read_curves(tmp_path / "a.mat")
    first, second = curves.values()
    assert_allclose(first.values, np.column_stack([curve, np.zeros(9)]))
    assert second.values.shape == (8, 3)
