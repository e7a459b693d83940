"""Tables as laboratories write them: each is read as meant, asked about, or refused with what to write."""

import numpy as np
import pytest
from import_cases import needle, plan_import
from refusals import refusal
from test_import import write_long, write_sheets

from needlefit.datasets.importing.answers import Answers, Stated
from needlefit.datasets.importing.files import read_asking, read_content
from needlefit.datasets.importing.planning import Planner
from needlefit.datasets.importing.tables import UnclearLayoutError
from needlefit.datasets.read import read
from needlefit.errors import DataError
from needlefit.geometry.stray_points import find_stray_points
from needlefit.project.unit_warnings import GAUGES_MM, doubt_layers
from needlefit.reporting.dataset_import import write_import

NEEDLES = [needle(n, 16) for n in range(3)]


def planned(paths, columns="", layout="", **options):
    """Return what files hold, the plan, and the decisions by name: (value, source)."""
    answers = Answers({key.replace("_", " "): value for key, value in options.items()})
    content = read_content(paths, columns, layout)
    plan = Planner(content, answers).make_plan()
    return content, plan, {one.what: (one.value, one.source) for one in answers.made}


def write_rows(path, rows):
    path.write_text("\n".join(",".join(map(str, row)) for row in rows), encoding="utf-8")
    return path


# ---- what is stated of needles in columns


@pytest.mark.parametrize(
    ("head", "cell", "what", "value"),
    [
        ("gauge", "22G", "outer_diameter_mm", GAUGES_MM[22]),
        ("Außendurchmesser [mm]", "0.7", "outer_diameter_mm", 0.7),
        ("calibre", "22", "outer_diameter_mm", GAUGES_MM[22]),
        ("diámetro (mm)", "0.7", "outer_diameter_mm", 0.7),
        ("直径 (mm)", "0.7", "outer_diameter_mm", 0.7),
        ("inner diameter [mm]", "0.3", "inner_diameter_mm", 0.3),
        ("Nadellänge [cm]", "20", "length_mm", 200.0),
        ("longueur d'aiguille (mm)", "200", "length_mm", 200.0),
        ("modulus (GPa)", "60", "youngs_modulus_gpa", 60.0),
        ("E-Modul [MPa]", "60000", "youngs_modulus_gpa", 60.0),
        ("needle material", "nitinol", "youngs_modulus_gpa", 60.0),
        ("弹性模量 (GPa)", "60", "youngs_modulus_gpa", 60.0),
    ],
)
def test_a_needle_is_stated_in_a_column(tmp_path, head, cell, what, value):
    content, plan, made = planned([write_long(tmp_path, NEEDLES, head=[head], cells=[[cell]] * 3)])
    assert getattr(plan.needle, what) == pytest.approx(value) and not plan.needles
    assert not content.unused and "file" in {source for _, source in made.values()}


def test_a_needle_is_longer_than_it_was_inserted(tmp_path):
    file = write_long(tmp_path, NEEDLES, head=["needle length"], cells=[["150"], ["50"], ["150"]])
    error = refusal(DataError, "needle length", planned, [file])
    assert error.where.endswith(f"{file.name}:18, column 2") and "n2" in error.expected


def test_needles_that_differ_are_each_their_own(tmp_path):
    cells = [["22G", "", "60"], ["18G", "", "60"], ["22G", "", "60"]]
    file = write_long(tmp_path, NEEDLES, head=["gauge", "bore (mm)", "modulus (GPa)"], cells=cells)
    _, plan, made = planned([file], inner_diameter="0.2")
    assert [row.needle for row in plan.rows] == ["needle1", "needle2", "needle1"]
    diameters = {name: one.outer_diameter_mm for name, one in plan.needles.items()}
    assert diameters == {"needle1": GAUGES_MM[22], "needle2": GAUGES_MM[18]}
    assert {one.inner_diameter_mm for one in plan.needles.values()} == {0.2}
    assert made["diameter"] == ("22G, 18G", "file") and made["inner diameter"][1] == "option"
    answers = Answers()
    write_import(tmp_path / "gel", *plan_import([file], answers), answers)
    found = {one.id: one.needle.flexural_rigidity for one in read(tmp_path / "gel").insertions}
    assert found["n2"] / found["n1"] == pytest.approx((GAUGES_MM[18] / GAUGES_MM[22]) ** 4)
    cells[1][0] = ""
    file = write_long(tmp_path, NEEDLES, head=["gauge", "bore (mm)", "modulus (GPa)"], cells=cells)
    assert "n2" in refusal(DataError, "diameter=", planned, [file]).what
    assert planned([file], diameter="20G")[1].rows[1].needle == "needle2"


@pytest.mark.parametrize("by", ["sheets", "columns", "two columns"])
def test_a_boundary_may_differ_from_needle_to_needle(tmp_path, by):
    depths = ["18", "19", "18"]
    if by == "sheets":
        sheets = {
            f"n{n}": [["boundaries (mm)", float(depth)], ["x", "y", "z"], *curve.tolist()]
            for n, (depth, curve) in enumerate(zip(depths, NEEDLES, strict=True))
        }
        file = write_sheets(tmp_path / "a.xlsx", **sheets)
    elif by == "columns":
        file = write_long(tmp_path, NEEDLES, head=["Grenztiefe"], cells=[[depth] for depth in depths])
    else:
        head, cells = ["boundary 1 [mm]", "boundary 2 [mm]"], [[depth, "40"] for depth in depths]
        file = write_long(tmp_path, NEEDLES, head=head, cells=cells)
    second = (40.0,) if by == "two columns" else ()
    _, plan, made = planned([file])
    assert [row.boundaries for row in plan.rows] == [(float(one), *second) for one in depths]
    assert made["boundaries"][1] == "file" and plan.boundaries_mm == {"medium1": ()}
    assert {row.layers for row in plan.rows} == {2 + len(second)}
    answers = Answers()
    write_import(tmp_path / "gel", *plan_import([file], answers), answers)
    found = [one.boundaries.tolist() for one in read(tmp_path / "gel").insertions]
    np.testing.assert_allclose(found, [[float(one), *second] for one in depths], atol=0.01)


def test_boundaries_that_are_those_of_each_medium_are_stated_once(tmp_path):
    cells = [["gel", "18"], ["fat", "20"], ["gel", "18"]]
    _, plan, _ = planned([write_long(tmp_path, NEEDLES, head=["medium", "boundary"], cells=cells)])
    assert plan.boundaries_mm == {"gel": (18.0,), "fat": (20.0,)}
    assert {row.boundaries for row in plan.rows} == {None}


def test_an_entry_and_a_direction_may_be_columns_of_each_needle(tmp_path):
    head = [f"{what} {axis}" for what in ("entry", "direction") for axis in "xyz"]
    cells = [["0", f"{3 * n}", "0", "1", "0", f"{0.01 * n}"] for n in range(3)]
    content, plan, _ = planned([write_long(tmp_path, NEEDLES, head=head, cells=cells)], bevel="0,1,0")
    assert [row.entry.tolist() for row in plan.rows] == [[0.0, 3.0 * n, 0.0] for n in range(3)]
    assert plan.rows[2].direction[2] == pytest.approx(0.02, abs=1e-5) and not content.unused


def test_a_column_of_deviations_is_that_of_each_point(tmp_path):
    rows = [["needle", "x", "y", "z", "sd"]]
    rows += [["a", *point, 0.1 + 0.01 * n] for n, point in enumerate(NEEDLES[0])]
    content, _, made = planned([write_rows(tmp_path / "a.csv", rows)])
    np.testing.assert_allclose(content.curves[0].points.sd, 0.1 + 0.01 * np.arange(16))
    assert made["point sd"][1] == "assumption"
    rows = [[*row[:-1], 0.07] if n else row for n, row in enumerate(rows)]
    content, plan, made = planned([write_rows(tmp_path / "a.csv", rows)])
    assert content.curves[0].points.sd is None and plan.point_sd_mm == 0.07
    assert made["point sd"] == ("0.07", "file")


def test_a_column_of_numbers_that_no_language_knows_is_an_assumption_and_is_asked_about(tmp_path):
    file = write_long(tmp_path, NEEDLES, head=["dicke", "wer"], cells=[["0.7", "me"]] * 3)
    content, plan, made = planned([file])
    assert [what for what, _ in content.unknown] == ["column dicke"]
    assert made["not used"][0] == "column wer" and plan.needle.outer_diameter_mm == GAUGES_MM[18]
    asked = []

    def answer(question, guess, reason):
        asked.append((guess, reason))
        return "diameter"

    content = read_asking([file], "", "", answer)
    assert len(asked) == 1 and not content.unknown
    assert {one.stated["diameter"].text for one in content.curves} == {"0.7"}
    content, plan, made = planned([file], "diameter=dicke")
    assert plan.needle.outer_diameter_mm == 0.7
    assert not planned([file], "unrelated=dicke")[0].unknown


# ---- bevel angles, pixels, order


def test_a_bevel_angle_is_asked_about_unless_a_side_stands_beside_it(tmp_path):
    file = write_long(tmp_path, NEEDLES, head=["bevel angle (deg)"], cells=[["20"]] * 3)
    fix = refusal(DataError, "bevel angle", planned, [file]).fix
    assert "bevel angle=roll" in fix and "bevel angle=cut" in fix
    assert "bevel side" not in planned([file], bevel_angle="cut")[2]
    assert planned([file], bevel_angle="roll")[2]["bevel side"] == ("20 deg", "file")
    head, cells = ["Schliffseite", "Schliffwinkel"], [["1", "20"], ["-1", "20"], ["1", "20"]]
    file = write_long(tmp_path, NEEDLES, head=head, cells=cells)
    _, plan, made = planned([file])
    assert [row.side for row in plan.rows] == [1, -1, 1] and made["bevel angle"] == ("cut", "file")


@pytest.mark.parametrize(
    ("axes", "scale", "decimals"),
    [("x y", 14.2, 1), ("u v", 4.0, 1), ("x[px] y[px]", 4.0, 1), ("x y", 4.0, 0)],
)
def test_pixels_are_no_millimetres(tmp_path, axes, scale, decimals):
    points = (NEEDLES[0][:, :2] * scale).round(decimals)
    file = write_rows(tmp_path / "a.csv", [["", *axes.split()], *([n, *p] for n, p in enumerate(points, 1))])
    assert "--units" in refusal(DataError, "units", planned, [file]).fix
    content, plan, made = planned([file], units=f"{1 / scale} mm")
    assert plan.rows[0].depth == pytest.approx(60.02, abs=0.5) and made["units"][1] == "option"
    assert content.unused == [("column 1", "a.csv:1")] and not content.unknown


def test_points_out_of_order_are_sorted_where_that_is_stated(tmp_path):
    order = np.random.default_rng(1).permutation(16)
    order = np.concatenate([[0], order[order != 0]])
    file = write_long(tmp_path, [NEEDLES[0][order], NEEDLES[1]])
    fix = refusal(DataError, "goes back", planned, [file]).fix
    assert "order=nearest" in fix and "--columns needle=" in fix
    content, _, _ = planned([file], order="nearest")
    for one, wanted in zip(content.curves, NEEDLES, strict=False):
        np.testing.assert_allclose(one.line, wanted, atol=1e-6)


# ---- layouts


def test_a_table_of_slicer_is_in_ras_and_its_labels_name_needles_and_points(tmp_path):
    rows = [["label", "r", "a", "s", "defined", "selected", "visible"]]
    for n, one in enumerate(NEEDLES, 1):
        rows += [[f"N{n}-{k}", -x, -y, z, 1, 1, 1] for k, (x, y, z) in enumerate(one, 1)]
    content, _, made = planned([write_rows(tmp_path / "a.csv", rows)])
    assert [one.name for one in content.curves] == ["N1", "N2", "N3"] and made["frame"][0] == "LPS"
    for one, wanted in zip(content.curves, NEEDLES, strict=True):
        np.testing.assert_allclose(one.line, wanted)
    rows = [rows[0], *([f"F-{n}", *row[1:]] for n, row in enumerate(rows[1:17], 1))]
    file = write_rows(tmp_path / "a.csv", rows)
    assert '"point number=label"' in refusal(DataError, "", planned, [file]).fix
    assert len(planned([file], "point number=label")[0].curves) == 1


@pytest.mark.parametrize("head", [["x", "y1", "y2", "y3"], ["x [mm]", "y n1 [mm]", "y n2 [mm]", "y n3 [mm]"]])
def test_needles_may_share_a_column_x(tmp_path, head):
    ends = [16, 13, 10]
    rows = [
        [x, *(f"{one[n, 1]}" if n < end else "" for one, end in zip(NEEDLES, ends, strict=True))]
        for n, x in enumerate(NEEDLES[0][:, 0])
    ]
    content, _, _ = planned([write_rows(tmp_path / "a.csv", [head, *rows])])
    assert [len(one.line) for one in content.curves] == ends and not content.unused
    for one, wanted in zip(content.curves, NEEDLES, strict=True):
        np.testing.assert_allclose(one.line[:, 1], wanted[: len(one.line), 1])


@pytest.mark.parametrize("kind", ["message", "markers", "named"])
def test_all_points_of_a_needle_may_stand_in_a_row(tmp_path, kind):
    curves = [one[:12] for one in NEEDLES]
    path = "/needle/shape/poses[{}]/position/"
    heads = {
        "message": [["__time", *(path.format(n) + axis for n in range(12) for axis in "xyz")]],
        "markers": [
            ["Format Version", 1.23],
            ["", "", *(f"needle:Marker {n:03}" for n in range(12) for _ in range(3))],
            ["", "", *(["Position"] * 36)],
            ["Frame", "Time (Seconds)", *("XYZ" * 12)],
        ],
        "named": [["needle", "bevel side", *(f"{axis}{n}" for n in range(1, 13) for axis in "xyz")]],
    }[kind]
    before = {"message": [[0.1], [0.2], [0.3]], "markers": [[1, 0.1], [2, 0.2], [3, 0.3]]}
    before |= {"named": [["a", 1], ["b", -1], ["c", 1]]}
    rows = [*heads, *([*own, *one.ravel()] for own, one in zip(before[kind], curves, strict=True))]
    file = write_rows(tmp_path / "a.csv", rows)
    assert "layout=rows" in refusal(UnclearLayoutError, "", planned, [file]).fix
    content, plan, made = planned([file], layout="rows")
    assert made["layout"] == ("rows", "option") and made["units"][1] == "assumption"
    for one, wanted in zip(content.curves, curves, strict=True):
        np.testing.assert_allclose(one.line, wanted)
    if kind == "named":
        assert [(row.id, row.side) for row in plan.rows] == [("a", 1), ("b", -1), ("c", 1)]


# ---- trackers


def test_poses_of_a_tip_without_depths_go_along_the_stage_axis(tmp_path):
    rows = [["time", *(f"T{i}{j}" for i in range(1, 5) for j in range(1, 5))]]
    for n, (x, y, z) in enumerate(NEEDLES[0]):
        rows.append([n, 1, 0, 0, 50 + z, 0, 1, 0, y, 0, 0, 1, -x, 0, 0, 0, 1])
    file = write_rows(tmp_path / "a.csv", rows)
    assert "--observable" in refusal(DataError, "observable", planned, [file]).fix
    content, _, made = planned([file], observable="tracks")
    assert made["pose"] == ("0,0,-1", "guess") and made["depth"][1] == "assumption"
    np.testing.assert_allclose(content.curves[0].readings.depth, NEEDLES[0][:, 0], atol=1e-9)
    assert np.ptp(content.curves[0].line[:, 0]) == pytest.approx(np.ptp(NEEDLES[0][:, 1]))
    content, _, _ = planned([file], observable="tracks", entry_point="50,0,-10")
    assert content.curves[0].readings.depth[0] == pytest.approx(2.0)  # readings before it are left out


def test_runs_of_other_needles_state_their_own(tmp_path):
    rows = [["run", "depth", "deflection", "diameter (mm)"]]
    rows += [[f"r{k}", x, 1e-3 * x**2, 0.5 + 0.1 * k] for k in range(2) for x in range(0, 60, 10)]
    answers = Answers({"specimen": "one"})
    write_import(tmp_path / "t", *plan_import([write_rows(tmp_path / "a.csv", rows)], answers), answers)
    found = [one.needle.outer_diameter for one in read(tmp_path / "t").insertions]
    assert found == pytest.approx([0.5, 0.6])


@pytest.mark.parametrize("guide", ["2", "none", "3"])
def test_one_of_two_tools_may_be_the_guide(tmp_path, guide):
    head = ["Frame", "Time", *["Q0", "Qx", "Qy", "Qz", "Tx", "Ty", "Tz", "Error"] * 2]
    rows = [
        [n, n / 60, 1, 0, 0, 0, x, y, z, 0.1, 1, 0, 0, 0, -20.0, 0.1 * n, 5.0, 0.1]
        for n, (x, y, z) in enumerate(NEEDLES[0])
    ]
    file = write_rows(tmp_path / "log.csv", [head, *rows])
    answers = {"observable": "tracks", "bevel": "0,1,0"}
    refusal(DataError, "guide", planned, [file], **answers)
    if guide == "3":
        refusal(DataError, "guide", planned, [file], **answers, guide=guide)
    if guide == "2":
        content, _, made = planned([file], **answers, guide=guide)
        assert len(content.curves) == 1 and made["guide"] == ("2", "option")
        np.testing.assert_allclose(content.curves[0].guide[:, 0], 0.1 * np.arange(16))
        settled = Answers(answers | {"guide": guide})
        write_import(tmp_path / "runs", *plan_import([file], settled), settled)
        (run,) = read(tmp_path / "runs").insertions
        np.testing.assert_allclose(run.guide.y, 0.1 * np.arange(16), atol=1e-4)


@pytest.mark.parametrize(
    ("head", "rows", "holes", "ends"),
    [
        # one depth of each needle; several of each; without names; along y and z; toward the bevel
        ("needle,depth,deflection", ["a,40,2.5", "b,60,5"], ["", ""], [(2.5, None), (5, None)]),
        ("needle,depth,deflection", ["a,40,2.5", "a,60,5"], ["a", "a"], [(2.5, None), (5, None)]),
        ("Tiefe [cm],Auslenkung [cm]", ["4,.2", "4,.3", "6,.5"], [""] * 3, [(2, None), (3, None), (5, None)]),
        ("needle,depth,tip y,tip z", ["a,40,2.5,1", "b,60,5,-1"], ["", ""], [(2.5, 1), (5, -1)]),
        ("needle,depth,deflection,side", ["a,40,2.5,1", "b,60,5,-1"], ["", ""], [(2.5, None), (-5, None)]),
    ],
)
def test_a_table_of_depths_and_deflections_is_of_tips(tmp_path, head, rows, holes, ends):
    (tmp_path / "a.csv").write_text("\n".join([head, *rows]) + "\n")
    answers = Answers({"point sd": "0.2"})
    content, plan = plan_import([tmp_path / "a.csv"], answers)
    assert [row.hole for row in plan.rows] == holes
    found = [(row.tip_y, row.tip_z) for row in plan.rows]
    assert np.array(found, dtype=float) == pytest.approx(np.array(ends, dtype=float), nan_ok=True)
    write_import(tmp_path / "tips", content, plan, answers)
    data = read(tmp_path / "tips")
    assert {one.observed for one in data.insertions} == {"tip"} and data.noise.point_sd == 0.2


def test_deflections_of_each_needle_at_many_depths_may_be_of_tips(tmp_path):
    rows = [["needle", "depth", "deflection"], *(["a", 10 * n, 0.1 * n] for n in range(1, 9))]
    file = write_rows(tmp_path / "a.csv", rows)
    assert planned([file])[1].pose == "tracker"
    _, plan, made = planned([file], observable="tips")
    assert made["observable"] == ("tips", "option")
    assert plan.pose == "known" and [row.depth for row in plan.rows] == [10 * n for n in range(1, 9)]


def test_one_place_of_each_needle_is_refused_and_curvatures_alone_are_read(tmp_path):
    rows = [["needle", "x", "y", "z"], *([f"n{n}", 40 + 5 * n, 0.1 * n, 0] for n in range(3))]
    assert "deflection" in refusal(DataError, "", read_content, [write_rows(tmp_path / "a.csv", rows)]).fix
    rows = [["needle", "s (mm)", "kappa_y", "kappa_z", "sd"], ["a", 10, 0.001, 0, 1e-4]]
    file = write_rows(tmp_path / "a.csv", rows)
    refusal(DataError, "inserted length", planned, [file])
    beside = write_rows(tmp_path / "b.csv", [["needle", "depth"], ["a", 40]])
    answers = Answers({})
    write_import(tmp_path / "read", *plan_import([file, beside], answers), answers)
    (one,) = read(tmp_path / "read").insertions
    assert one.observed == "curvature" and one.depth == 40
    # half of the curvature times the square of the length
    assert one.points[-1, 1] == pytest.approx(0.001 * 40**2 / 2, rel=1e-3)


def test_sensors_may_be_placed_from_the_base(tmp_path):
    write_long(tmp_path, NEEDLES[:1])
    rows = [
        ["needle", "sensor location from base [mm]", "curvature_x [1/m]", "curvature_y [1/m]", "sd [1/m]"]
    ]
    write_rows(tmp_path / "bragg.csv", [*rows, ["n1", 120, 2.0, 0.1, 0.05], ["n1", 150, 1.0, 0.2, 0.05]])
    named = "curvature y=curvature_x [1/m],curvature z=curvature_y [1/m]"
    answers = {"pose": "1,0,0", "bevel": "0,1,0", "needle_length": "165"}
    assert "curvature z=" in refusal(DataError, "curvature z", planned, [tmp_path], **answers).fix
    _, plan, _ = planned([tmp_path], named, **answers)
    wanted = [[45.0, 2e-3, 1e-4, 5e-5], [15.0, 1e-3, 2e-4, 5e-5]]
    np.testing.assert_allclose(plan.rows[0].curvature, wanted, atol=1e-12)


def test_what_stands_above_the_first_block_holds_for_those_below(tmp_path):
    rows = [["diameter", "0.7", "mm"], ["boundaries", "20", "mm"]]
    for name, curve in zip("ab", NEEDLES, strict=False):
        rows += [["needle", name], ["x [mm]", "y [mm]", "z [mm]"], *curve.tolist(), []]
    rows.insert(len(rows) // 2 + 1, ["boundaries", "25", "mm"])
    _, plan, _ = planned([write_rows(tmp_path / "a.csv", rows)])
    assert plan.needle.outer_diameter_mm == 0.7 and not plan.needles
    assert [row.boundaries for row in plan.rows] == [(20.0,), (25.0,)]


# ---- tables of needles beside the points


def write_both(folder, points, rows, head=("specimen",), cells=None):
    """Points of needles under some names, and a table with a specimen, or other cells, for each name."""
    lines = [["needle", "x [mm]", "y [mm]", "z [mm]"]]
    lines += [[name, *p] for name, one in zip(points, NEEDLES, strict=True) for p in one]
    write_rows(folder / "points.csv", lines)
    cells = cells or [[f"block {n}"] for n in range(len(rows))]
    own = [[name, *texts] for name, texts in zip(rows, cells, strict=True)]
    write_rows(folder / "needles.csv", [["needle", *head], *own])
    return folder


@pytest.mark.parametrize(
    ("points", "rows"),
    [
        (["1.0", "2.0", "3.0"], ["1", "2", "3"]),
        (["1", "2", "10"], ["01", "02", "10"]),
        (["007", "008", "105"], ["7.0", "8.0", "105.00"]),
        (["n1", "n2", "n10"], ["N01", "N02", "N10"]),
        (["1.1", "1.10", "1.2"], ["1.1", "1.10", "1.2"]),
    ],
)
def test_names_that_are_equal_as_numbers_are_one_name(tmp_path, points, rows):
    _, plan, made = planned([write_both(tmp_path, points, rows)])
    assert [row.specimen for row in plan.rows] == ["block 0", "block 1", "block 2"]
    assert ("needle names" in made) == (points != rows)


@pytest.mark.parametrize(
    ("points", "rows"),
    [
        (["a", "b", "c"], ["p", "q", "r"]),
        (["1.1", "1.3", "1.2"], ["1.10", "1.30", "1.20"]),  # the tenth needle of block 1 is not the first
        (["n1", "n2", "n3"], ["105", "205", "305"]),
        (["1", "2", "3"], ["10", "20", "30"]),
    ],
)
def test_a_table_that_names_no_needle_stops_the_import(tmp_path, points, rows):
    error = refusal(DataError, rows[0], planned, [write_both(tmp_path, points, rows)])
    assert points[0] in error.expected and error.where.startswith(f"{tmp_path / 'needles.csv'}:2")


def test_two_spellings_of_one_number_match_none(tmp_path):
    folder = write_both(tmp_path, ["1", "b", "c"], ["01", "1.0", "b"])
    assert refusal(DataError, "specimen", planned, [folder])
    (tmp_path / "needles.csv").write_text("needle,modulus\n01,60\n1.0,70\nb,80\nc,80\n")
    assert len(read_content([tmp_path]).doubts) == 2


def test_merged_cells_are_filled_down_and_blank_ones_are_not(tmp_path):
    from openpyxl import load_workbook

    points = [["needle", "x", "y", "z"]]
    points += [[name, *p] for name, one in zip("abc", NEEDLES, strict=True) for p in one.tolist()]
    needles = [["needle", "specimen"], ["a", "gel 1"], ["b", None], ["c", "gel 2"]]
    file = write_sheets(tmp_path / "a.xlsx", points=points, needles=needles)
    fix = refusal(DataError, "not of b", planned, [file]).fix
    assert "fill in" in fix
    book = load_workbook(file)
    book["needles"].merge_cells("B2:B3")
    book["points"].merge_cells("A2:A17")
    book.save(file)
    assert [row.specimen for row in planned([file])[1].rows] == ["gel 1", "gel 1", "gel 2"]


@pytest.mark.parametrize("head", ["exclude", "Ausreißer", "valide", "excluido", "剔除"])
@pytest.mark.parametrize("marks", [["", "x", ""], ["0", "1", "0"], ["yes", "yes", "no"]])
def test_a_column_that_marks_rows_is_an_assumption(tmp_path, head, marks):
    folder = write_both(tmp_path, "abc", "abc", [head], [[one] for one in marks])
    (own,) = read_content([folder]).doubts.values()
    assert all(f"{mark or 'blank'} in {marks.count(mark)}" in own for mark in marks)
    assert not read_content([folder], f"unrelated={head}").doubts
    same = write_both(tmp_path, "abc", "abc", [head], [["1"]] * 3)
    assert not read_content([same]).doubts


@pytest.mark.parametrize("row", [0, 4, 15, 47])
@pytest.mark.parametrize("change", [lambda text: text.replace(".", ","), "{} mm".format, "{}*".format])
def test_a_point_whose_numbers_are_not_understood_stops_the_import(tmp_path, row, change):
    lines = [f"{name};{x:.3f};{y:.3f};{z:.3f}" for name, one in zip("abc", NEEDLES, strict=True)
             for x, y, z in one]  # fmt: skip
    lines[row] = ";".join(text if text in "abc" else change(text) for text in lines[row].split(";"))
    (tmp_path / "a.csv").write_text("\n".join(["needle;x;y;z", *lines]))
    error = refusal(DataError, "a number is", read_content, [tmp_path])
    assert error.where == f"{tmp_path / 'a.csv'}:{row + 2}, column 2"


# ---- numbers that are no places


@pytest.mark.parametrize("unit", ["", " [mm]", " [cm]"])
@pytest.mark.parametrize(("column", "code"), [(0, 999), (1, 999), (1, -999), (2, 9999), (slice(3), 99999)])
@pytest.mark.parametrize("points", [[0], [7], [15], [7, 8]])
def test_a_code_of_a_missing_value_is_named_with_its_row_and_no_unit_is_proposed(
    tmp_path, unit, column, code, points
):
    scale = 0.1 if "cm" in unit else 1.0
    curves = [scale * one for one in NEEDLES]
    curves[1] = curves[1].copy()
    curves[1][points, column] = code
    rows = [["needle", *(axis + unit for axis in "xyz")]]
    rows += [[name, *point] for name, one in zip("abc", curves, strict=True) for point in one]
    error = refusal(DataError, f"{code}", planned, [write_rows(tmp_path / "a.csv", rows)])
    assert error.where == f"{tmp_path / 'a.csv'}:{18 + points[0]}" and "--units" not in error.fix


@pytest.mark.parametrize("step", [0.1, 0.5, 5.0])
def test_noise_is_no_stray_point(step):
    random = np.random.default_rng(round(10 * step))
    for _ in range(100):
        curve = needle(0, int(60 / step) + 1)
        assert not len(find_stray_points(curve + random.normal(0.0, 0.2, curve.shape)))
        cluster = np.vstack([curve[: max(4, len(curve) // 8)], curve[-1:]])  # dense at the entry, and the tip
        assert not len(find_stray_points(cluster))


def test_a_pose_against_the_needles_is_corrected_by_its_sign_or_by_the_order_of_points(tmp_path):
    file = write_long(tmp_path, NEEDLES)
    fix = refusal(DataError, "pose", planned, [file], pose="-1,0,0").fix
    assert "--pose 1,0,0" in fix and "--entry last" in fix
    assert planned([file], pose="1,0,0")[1].rows[0].direction[0] == 1.0
    assert planned([file], pose="-1,0,0", entry="last")[1].rows[0].direction[0] == -1.0


def test_a_table_of_needles_with_unknown_headers_is_an_assumption(tmp_path):
    folder = write_both(tmp_path, "abc", "abc", ["gewebeart"], [["1"], ["2"], ["2"]])
    content = read_content([folder])
    assert [what for what, _ in content.doubts] == ["file needles.csv"]
    (tmp_path / "needles.csv").write_text("lab,Berlin\nroom,12\n")
    content = read_content([folder])
    assert [what for what, _ in content.unused] == ["file needles.csv"] and not content.doubts


def test_a_mistyped_name_of_the_sheet_setup_is_an_assumption(tmp_path):
    points = [["needle", "x", "y", "z"]]
    points += [[name, *p] for name, one in zip("abc", NEEDLES, strict=True) for p in one.tolist()]
    setup = [["question", "answer"], ["specimens", "gel 1"], ["modulos", "200"]]
    content = read_content([write_sheets(tmp_path / "a.xlsx", points=points, setup=setup)])
    doubts = {what: why for (what, _), why in content.doubts.items()}
    assert doubts.keys() == {"row specimens = gel 1", "row modulos = 200"}
    assert "`specimen`" in doubts["row specimens = gel 1"] and "`modulus`" in doubts["row modulos = 200"]


@pytest.mark.parametrize(
    ("head", "cells", "what", "value"),
    [
        ("needle gauge", "22G", "outer_diameter_mm", GAUGES_MM[22]),
        ("Kanüle", "G20", "outer_diameter_mm", GAUGES_MM[20]),
        ("needle size", "22", "outer_diameter_mm", GAUGES_MM[22]),
        ("Material", "nitinol", "youngs_modulus_gpa", 60.0),
        ("módulo", "60", "youngs_modulus_gpa", 60.0),
    ],
)
def test_words_of_the_needle_are_known(tmp_path, head, cells, what, value):
    _, plan, _ = planned([write_long(tmp_path, NEEDLES, head=[head], cells=[[cells]] * 3)])
    assert getattr(plan.needle, what) == pytest.approx(value)


def test_an_unknown_column_of_quantities_is_asked_about_and_one_of_words_is_not(tmp_path):
    file = write_long(tmp_path, NEEDLES, head=["foo", "bar", "baz"], cells=[["22G", "Anna", "0.7 mm"]] * 3)
    assert [what for what, _ in planned([file])[0].unknown] == ["column foo", "column baz"]


def test_a_field_of_numbers_that_no_language_knows_is_an_assumption_and_can_be_named(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"needles": np.stack(NEEDLES, axis=2), "qq": 60.0, "note": "mine"})
    content, _, made = planned([tmp_path / "a.mat"])
    assert content.unknown == [("field qq", "a.mat")] and made["units"][1] == "assumption"
    assert planned([tmp_path / "a.mat"], "modulus=qq")[1].needle.youngs_modulus_gpa == 60.0


@pytest.mark.parametrize("by", ["columns", "rows"])
@pytest.mark.parametrize("guide", ["base", "none", None, "stage"])
def test_a_moving_base_is_the_guide_only_where_that_is_stated(tmp_path, by, guide):
    rows = [["time", "tip x", "tip y", "tip z", "base x", "base y", "base z"]]
    rows += [[n, x, y, z, -20.0, 0.1 * n, 5.0] for n, (x, y, z) in enumerate(NEEDLES[0])]
    if by == "rows":
        pairs = [
            [(n, "tip", x, y, z), (n, "base", -20.0, 0.1 * n, 5.0)] for n, (x, y, z) in enumerate(NEEDLES[0])
        ]
        rows = [["time", "tool", "x", "y", "z"], *(row for pair in pairs for row in pair)]
    file = write_rows(tmp_path / "log.csv", rows)
    answers = {"observable": "tracks", "bevel": "0,1,0", "pose": "1,0,0"} | (
        {"guide": guide} if guide else {}
    )
    if guide == "stage" or (guide is None and by == "columns"):
        refusal(DataError, "guide", planned, [file], **answers)
    elif guide == "base":
        content, _, _ = planned([file], **answers)
        np.testing.assert_allclose(content.curves[0].guide[:, 0], 0.1 * np.arange(16), atol=1e-9)


def test_text_of_windows_in_chinese_is_read(tmp_path):
    rows = ["针号,X (毫米),Y (毫米),Z (毫米),规格"]
    rows += [f"n{n},{x},{y},{z},a" for n, one in enumerate(NEEDLES) for x, y, z in one]
    (tmp_path / "a.csv").write_bytes("\n".join(rows).encode("gb18030"))
    content, _, made = planned([tmp_path / "a.csv"])
    assert len(content.curves) == 3 and made["units"] == ("mm", "file")


def test_needles_that_do_not_bend_need_a_stated_bevel_alone(tmp_path):
    straight = [one * [1.0, 0.0, 0.0] for one in NEEDLES]
    file = write_long(tmp_path, straight, head=["bevel"], cells=[["1"], ["-1"], ["1"]])
    assert "--bevel" in refusal(DataError, "bevel", planned, [file], pose="1,0,0").fix
    _, plan, _ = planned([file], pose="1,0,0", bevel="0,1,0")
    assert [row.side for row in plan.rows] == [1, -1, 1]


@pytest.mark.parametrize(("text", "mm"), [(".7", 0.7), ("0.7e0", 0.7), ("7e-1 mm", 0.7)])
def test_numbers_may_begin_with_a_point_or_have_an_exponent(tmp_path, text, mm):
    _, plan, _ = planned([write_long(tmp_path, NEEDLES)], diameter=text)
    assert plan.needle.outer_diameter_mm == pytest.approx(mm)


def test_a_stated_depth_is_kept_where_that_of_another_run_is_measured(tmp_path):
    lines = [(n, x, y, z) for n, (x, y, z) in enumerate(NEEDLES[0])]
    write_rows(
        tmp_path / "a.csv", [["time", "depth", "x", "y", "z"], *([n, 1 + x, x, y, z] for n, x, y, z in lines)]
    )
    write_rows(tmp_path / "b.csv", [["time", "x", "y", "z"], *lines])
    content, _, _ = planned([tmp_path], observable="tracks", bevel="0,1,0")
    assert [one.readings.depth[0] for one in content.curves] == [1.0, 0.0]


def test_no_other_end_is_advised_where_points_begin_at_the_stated_entry(tmp_path):
    """A mistyped pose is one: the other end would be at the tip."""
    curves = {f"n{n}": needle(n) - [0.0, 3.0 * n, 0.0] for n in range(3)}
    rows = [[name, *point] for name, points in curves.items() for point in points]
    write_rows(tmp_path / "a.csv", [["needle", "x", "y", "z"], *rows])
    stated = {"pose": "-1,0,0", "bevel": "0,1,0", "entry_point": "0,0,0"}
    found = refusal(DataError, "pose", planned, [tmp_path / "a.csv"], **stated)
    assert "--pose 1,0,0" in found.fix and "--entry" not in found.fix
    found = refusal(DataError, "", planned, [tmp_path / "a.csv"], **stated, entry="last")
    assert "--entry first" in found.fix and "--entry last" not in found.fix


@pytest.mark.parametrize("text", ["75e9", "-75"])
def test_a_modulus_that_is_refused_names_the_units_that_may_stand_behind_it(text):
    found = refusal(DataError, "modulus", Stated(text).to_number, "modulus", "GPa", is_above=True)
    assert all(unit in found.expected for unit in ("GPa", "MPa", "Pa"))


@pytest.mark.parametrize(
    ("value", "unit"),
    [(999.0, ""), (200.0, ""), (20000.0, "micrometres"), (0.02, "metres")],
)
def test_a_unit_of_a_boundary_is_guessed_only_where_it_makes_a_likely_one(value, unit):
    ((_, what, fix),) = doubt_layers((value,), 70.0, "boundaries_mm")
    assert ("looks like" in what) == bool(unit) and unit in what
    assert fix.startswith("write" if unit else "check it, in mm")
