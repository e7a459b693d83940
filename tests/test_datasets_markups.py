"""Markups of 3D Slicer: what a file says is what is read, in LPS; what it does not say is an error."""

import json
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refusal, refused_file
from test_datasets import CURVE, SURFACES, record, row

from needlefit.datasets.columns import SCAN_COLUMNS
from needlefit.datasets.formats import find_format
from needlefit.datasets.formats.markups import CurveStyle, Markups, pick_list, read_markups, write_mrk_json
from needlefit.datasets.read import read
from needlefit.datasets.write import write_dataset
from needlefit.errors import ConfigError, DataError

anything = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
coordinate = st.floats(-1e6, 1e6)

SCHEMA = "https://raw.githubusercontent.com/slicer/slicer/master/markups-schema-v1.0.{}.json#"
HEADER = "# Markups fiducial file version = {}\n# CoordinateSystem = {}\n"
COLUMNS = "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
BODY = "0,1,2,3,0,0,0,1,1,1,0,F-1,,\n"


def point(n, position, **changes):
    return {"id": str(n), "label": f"F-{n}", "position": position} | changes


def markup(kind="Fiducial", system="LPS", points=((1, 2, 3), (4, 5, 6)), **changes):
    listed = [p if isinstance(p, dict) else point(n, list(p)) for n, p in enumerate(points, 1)]
    found = {"type": kind, "coordinateSystem": system, "coordinateUnits": "mm", "controlPoints": listed}
    return {k: v for k, v in (found | changes).items() if v is not None}


def save(path, *lists, version=3, **changes):
    path.write_text(json.dumps({"@schema": SCHEMA.format(version), "markups": list(lists)} | changes))
    return path


def read_one(path):
    return pick_list(read_markups(path), path)


def read_curves(path):
    return find_format(path).read_curves(path)[0]


def read_points(path):
    return find_format(path).read_one(path, {}, [])


@pytest.fixture
def file(tmp_path):
    return tmp_path / "F.mrk.json"


def refused(path, reader=read_one):
    error = refused_file(reader, path)
    return f"{error.where}: {error.what}"


def test_points_are_read_in_lps_and_millimetres_and_unset_ones_left_out(file):
    # Right becomes left, anterior posterior; up stays up.
    for system, sign in [("LPS", 1), ("RAS", -1)]:
        found = read_one(save(file, markup(system=system)))
        assert found.points.tolist() == [[sign, 2 * sign, 3], [4 * sign, 5 * sign, 6]]
        assert (found.labels, found.name, found.kind) == (("F-1", "F-2"), "F", "Fiducial")
        assert found.system == ("LPS" if sign > 0 else "RAS")
    for units, factor in [(None, 1), ("um", 1e-3), (["mm", "UCUM", "millimeter"], 1)]:
        found = read_one(save(file, markup(coordinateUnits=units)))
        assert_allclose(found.points, factor * np.array([[1, 2, 3], [4, 5, 6]]), rtol=1e-15)
    points = [
        point(1, "", positionStatus="undefined"),
        point(2, [1, 1, 1], positionStatus="preview"),
        point(3, [7, 8, 9], positionStatus="defined", locked=True, visibility=False, selected=False),
        point(4, [0, 0, 0], positionStatus="missing"),
    ]
    found = read_one(save(file, markup(points=points)))
    assert found.points.tolist() == [[7, 8, 9]]
    assert (found.labels, found.unset) == (("F-3",), ("F-1", "F-2", "F-4"))


UNSET = [point(1, ""), point(2, "")]
FAULTY = [  # what a file holds, and what is said of it
    *(("[" * 100_000, "JSON"), ('{"nodes": []}', "has no `markups`"), ([markup("Plane")], "Plane")),
    *(([markup(system=system)], "list 1, key `coordinateSystem`") for system in (None, "IJK")),
    ([markup(coordinateUnits="inch")], "key `coordinateUnits`"),
    *(([markup(points=[])], "is empty"), ([markup(points=UNSET)], "2 points")),
    ([markup(points=[point(1, [1, 2, 3], positionStatus="there")])], "key `controlPoints.1.positionStatus`"),
    *(
        ([markup(points=[(0, 0, 0), point(2, position)])], "list 1, key `controlPoints.2.position`")
        for position in ([1, float("nan"), 3], [1, 2], "123", [1, 2, 10**400])
    ),
]  # fmt: skip


@pytest.mark.parametrize(("content", "words"), FAULTY)
def test_faults_of_a_json_file(file, content, words):
    file.write_text(content) if isinstance(content, str) else save(file, *content)
    assert words in refused(file)
    assert "schema is" in refused(save(file, markup(), **{"@schema": "annotations-v2"}))


@pytest.mark.parametrize(
    ("version", "system", "sign"),
    [("4.4", "0", -1), ("4.10", "1", 1), ("4.13", "RAS", -1), ("5.2", "LPS", 1)],
)
def test_fcsv_of_every_version(tmp_path, version, system, sign):
    path = tmp_path / "F.fcsv"
    tail = ",2,0" if version == "5.2" else ""
    rows = f'0,1,2.5,3,0,0,0,1,1,1,0,F-1,,{tail}\n\n1,4,5,6,0,0,0,1,0,0,1,"a, b",note,{tail}\n'
    path.write_text(HEADER.format(version, system) + COLUMNS + rows)
    found = read_one(path)
    assert found.points.tolist() == [[sign * 1, sign * 2.5, 3], [sign * 4, sign * 5, 6]]
    assert (found.labels, found.descriptions) == (("F-1", "a, b"), ("", "note"))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("# Markups fiducial file version = 4.11\n" + COLUMNS + BODY, "key `coordinateSystem`"),
        (
            HEADER.format("4.11", "LPS") + "# columns = id,x,y,label\n" + BODY,
            "key `controlPoints.1.position`",
        ),
        (HEADER.format("5.2", "LPS") + COLUMNS + BODY.rstrip() + ",0,0\n", "1 points"),
        ("\udcff\udcfe#", "text"),
    ],
)
def test_fcsv_faults(tmp_path, content, words):
    path = tmp_path / "F.fcsv"
    path.write_bytes(content.encode(errors="surrogateescape"))
    assert words in refused(path)


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=12), st.text(max_size=9))
@anything
def test_what_is_written_is_read_back(tmp_path, points, label):
    path = tmp_path / "curve.mrk.json"
    array = np.array(points)
    labels = (label, *["p"] * (len(points) - 1))
    lists = [Markups(path, name, "Curve", labels, array) for name in ("fit", "95 % band")]
    write_mrk_json(path, [(one, CurveStyle((0.0, 0.5, 1.0))) for one in lists])
    first, second = read_markups(path)
    assert_allclose(first.points, array, rtol=0, atol=1e-9)
    assert_array_equal(second.points, array)
    assert (first.labels, first.name, first.kind, first.system) == (labels, "fit", "Curve", "LPS")


def dataset(folder, pattern, **frame):
    data = record(frame={"name": "world", **frame}) if frame else record()
    rows = [row("a", "given", layers=2)]
    file = write_dataset(folder, data, rows, {"a": CURVE}, SURFACES, checksums=False)
    text = file.read_text()
    file.write_text(text.replace("{id}.csv", pattern))
    return file, folder / "centerlines"


def test_the_scan_is_placed_by_the_dataset_or_a_row(tmp_path):
    # A quarter turn about z and a shift: what lies at (x, y, z) in the scan is at (-y + 1, x + 2, z + 3).
    motion = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]]
    file, folder = dataset(tmp_path / "d", "{id}.mrk.json", lps_to_world=motion)
    x, y, z = CURVE.T
    save(folder / "a.mrk.json", markup("Curve", "LPS", np.column_stack([y - 2, 1 - x, z - 3]).tolist()))
    found = read(file)
    assert_allclose(found.insertions[0].centerline, CURVE, atol=1e-12)
    assert_allclose(found.insertions[0].patient.to_world([[5.0, 0, 0]]), [[1, 7, 3]], atol=1e-12)
    # The row's motion, a half turn about z, is used, not the dataset's.
    identity = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]
    file, folder = dataset(tmp_path / "d", "{id}.mrk.json", lps_to_world=identity)
    table = file.parent / "insertions.csv"
    head, line = table.read_text().splitlines()
    table.write_text(f"{head},{','.join(SCAN_COLUMNS)}\n{line},0,0,180,0,0,5\n")
    save(folder / "a.mrk.json", markup("Curve", "LPS", (CURVE * [-1, -1, 1] - [0, 0, 5]).tolist()))
    assert_allclose(read(file).insertions[0].centerline, CURVE, atol=1e-12)


@pytest.mark.parametrize("axis", [[2, 0, 0, 0], [-1, 0, 0, 0], [1, 0.1, 0, 0], [1, 0, 0]])
def test_a_motion_with_scale_reflection_or_shear_is_refused(tmp_path, axis):
    file, _ = dataset(tmp_path / "d", "{id}.csv", lps_to_world=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])
    file.write_text(re.sub(r"(lps_to_world = \[)\[.*?\]", rf"\1{axis}", file.read_text()))
    refusal((ConfigError, DataError), "lps_to_world", read, file)


def test_only_open_curves_are_centrelines(file):
    for kind in ("ClosedCurve", "Line", "Angle"):
        assert f"a {kind}, " in refused(save(file, markup(kind)), read_points)
    save(file, markup("Curve", name="a"), markup("Curve", name="b"))
    assert "2 lists: `a` (Curve), `b` (Curve)" in refused(file, read_points)
    assert list(read_curves(file)) == ["a", "b"]
    save(file, markup("Curve", name="a"), markup("Curve", name="a"))
    assert "2 lists called `a`" in refused(file, read_curves)
