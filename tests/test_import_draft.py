"""A mapping is drafted: what is sure, what is assumed, what is asked, and that each printed fix works."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from import_cases import (
    curves_of,
    needle,
    planned,
    prepare,
    write_long,
    write_markups,
    write_rows,
    write_sheets,
)
from numpy.testing import assert_allclose
from pytest import approx
from refusals import refusal

from needlefit.datasets.importing.meanings import read_header
from needlefit.datasets.importing.prepare import prepare_import
from needlefit.datasets.importing.stated import Stated
from needlefit.datasets.importing.tables import parse_number
from needlefit.errors import ConfigError, DataError
from needlefit.project.locate import read_toml
from needlefit.project.unit_warnings import GAUGES_MM

CASES = Path(__file__).with_name("imports")
NEEDLES = [needle(n, 16) for n in range(3)]


# ---- words, numbers


WORDS = read_toml(CASES / "words.toml")


def test_numbers_are_read_by_their_signs():
    for text, decimal, thousands, value in WORDS["numbers"]:
        assert parse_number(text, decimal, thousands) == (None if value == "none" else value)


def test_headers_are_known_in_five_languages():
    for meaning, texts in WORDS["headers"].items():
        assert {read_header(text).meaning or "none" for text in texts} == {meaning}


@pytest.mark.parametrize(("text", "unit", "angle"), WORDS["bevels"])
def test_a_bevel_is_understood_or_refused(text, unit, angle):
    """It is never a default."""
    cell = Stated("bevel_side", text, unit, "a.csv:2")
    if angle == "none":
        assert refusal(DataError, "bevel_side", cell.to_angle).where == "a.csv:2"
    else:
        assert cell.to_angle() == angle


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize(
    ("separator", "decimal"), [(";", ","), ("\t", "."), (",", "."), (" ", ","), (",", ",")]
)
def test_separator_decimal_sign_and_encoding_are_found(tmp_path, encoding, separator, decimal):
    cell = '"{:.3f}"' if separator == decimal else "{:.3f}"
    lines = [separator.join(cell.format(value).replace(".", decimal) for value in row) for row in NEEDLES[0]]
    (tmp_path / "a.txt").write_bytes("\n".join([separator.join("xyz"), *lines]).encode(encoding))
    curves, draft = curves_of([tmp_path / "a.txt"])
    assert (draft.tables[0]["separator"], draft.tables[0]["decimal"]) == (separator, decimal)
    assert_allclose(curves["a"].line, NEEDLES[0], atol=1e-3)


# ---- single files


def test_known_answers_of_single_files():
    plan, made = planned([CASES / "matrices.csv"], holds="tracks")
    assert made["pose"] == ("1,0,0", "assumed") and plan.rows[0].entry is None
    content = prepare([CASES / "m3.csv"], deflection__column="lateral [mm]").content
    assert_allclose(content.curves[0].line[:4, 0], [0.5, 0.1, 0.15, 0.2])
    sds = prepare([CASES / "d07_mean_sd.csv"], point_sd__column="SD [mm]", point_sd__divide_by_root="n")
    assert sds.plan.point_sd_mm == approx(0.12 / np.sqrt(5))
    clock = planned([CASES / "d24_tips_clock.csv"])[0].rows
    toward = [(row.bevel * row.side).round(6).tolist() for row in clock[:4]]
    assert toward == [[0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, -1]]
    assert [row.tip_y * row.side for row in clock[:4]] == approx([0.56, 0.68, 0.84, 0.90])


# ---- a table of tables

TABLES = read_toml(CASES / "tables.toml")["case"]


@pytest.mark.parametrize("case", TABLES, ids=[f"{n}" for n, _ in enumerate(TABLES)])
def test_tables_are_read_as_they_are_meant(tmp_path, case):
    cells = case.get("cells", [[]] * 3)
    if "plane" in case:
        start = case.get("offset", 0)
        file = write_plane(
            tmp_path / "a.csv", case["plane"], lambda k: cells[k - 1], lambda s, y: (s + start, y)
        )
        file.write_text("\n".join([*case.get("above", ()), file.read_text()]), encoding="utf-8")
        paths = [file]
    elif "long" in case:
        paths = [write_long(tmp_path, NEEDLES, "a.csv", case["long"], cells)]
    elif "text" in case:
        (tmp_path / "a.csv").write_text(case["text"])
        paths = [tmp_path / "a.csv"]
    else:
        paths = [CASES / name for name in case["files"]]
    for name, text in case.get("beside", {}).items():
        (tmp_path / name).write_text(text)
        paths.append(tmp_path / name)
    stated = [*case.get("state", {}).items()]
    if "fix" in case:
        error = refusal(DataError, "", prepare_import, paths, stated)
        assert case["fix"] in error.fix and case.get("what", "") in error.what
        assert error.where.endswith(case.get("where", ""))
        return
    prepared = prepare_import(paths, stated)
    plan, assumed = prepared.plan, prepared.mapping.assumed.keys()
    for name, right in case.get("rows", {}).items():
        found = [getattr(row, name) for row in plan.rows]
        if isinstance(right[0], str):
            assert found == right
        else:
            assert_allclose(np.array(found), right, atol=0.5 if name == "depth" else 1e-3)
    for name, right in case.get("first", {}).items():
        assert getattr(plan.rows[0], name) == approx(right)
    for name, right in case.get("needle", {}).items():
        assert getattr(plan.needle, name) == approx(right) and not plan.needles
    if "last" in case:
        ends = [curve.line[-1] for curve in prepared.content.curves]
        assert_allclose(ends, case["last"], atol=1e-3)
    if "sensors" in case:
        sensors = [np.array(curve.sensors)[:, :3] for curve in prepared.content.curves]
        assert_allclose(sensors, case["sensors"])
    if "moduli" in case:
        needles = [plan.needles.get(row.needle, plan.needle) for row in plan.rows]
        assert [one.youngs_modulus_gpa for one in needles] == case["moduli"]
    if "boundaries" in case:
        assert plan.boundaries_mm == {name: tuple(depths) for name, depths in case["boundaries"].items()}
    assert {*case.get("assumed", ())} <= assumed and not {*case.get("stated", ())} & assumed
    assert {*case.get("noted", ())} <= {what for what, _ in prepared.notes}
    if "depth_units" in case:
        columns = [table.columns for table in prepared.mapping.tables]
        assert [one["depth"].unit for one in columns if "depth" in one] == case["depth_units"]
    assert "unused" not in case or {what for what, _ in prepared.unused} == {*case["unused"]}


# ---- words and layouts that labs use in two ways

FLAGGED = {(0, 5), (2, 7)}  # points that are wrong, and marked


def long_rows(*more):
    """A row a point: its needle, cells that `more` makes of needle and point, x, y, z."""
    return [
        [f"n{n}", *(make(n, k) for make in more), *point]
        for n, one in enumerate(NEEDLES)
        for k, point in enumerate(one.tolist())
    ]


TWO_WAYS = {
    "x_filt": (["x_raw", "y_raw", "z_raw", "x_filt", "y_filt", "z_filt"], [lambda n, k: 9.0 * k] * 3),
    "x_mm": (["x_px", "y_px", "z_px", "x_mm", "y_mm", "z_mm"], [lambda n, k: 9.0 * k] * 3),
    "measured x": (
        [f"{kind} {axis}" for kind in ("planned", "measured") for axis in "xyz"],
        [lambda n, k: k] * 3,
    ),
    "excluded": (["valid", *"xyz"], [lambda n, k: int((n, k) not in FLAGGED)]),
    "bevel_side.words": (["side", *"xyz"], [lambda n, k: "AB"[n % 2]]),
    "bevel_side.unit": (["side", *"xyz"], [lambda n, k: 180 * (n % 2)]),
    "specimen.column": (["phantom", *"xyz"], [lambda n, k: "PQ"[n % 2]]),
    "holds=shapes": (["depth", *"xyz"], [lambda n, k: np.linalg.norm(NEEDLES[n][k] - NEEDLES[n][0])]),
}


@pytest.mark.parametrize("answer", TWO_WAYS)
def test_what_labs_use_in_two_ways_is_asked(tmp_path, answer):
    head, more = TWO_WAYS[answer]
    file = write_rows(tmp_path / "a.csv", [["needle", *head], *long_rows(*more)])
    options = re.split(r"state |, or ", refusal(DataError, "needs an answer", prepare_import, [file]).fix)
    words = shlex.split(next(option for option in options if answer in option))
    stated = [word.split("=", 1) for word in words if word != "--set"]
    prepared = prepare_import([file], stated)
    for n, curve in enumerate(prepared.content.curves):
        left_out = [k for m, k in FLAGGED if m == n and answer == "excluded"]
        assert_allclose(curve.line, np.delete(NEEDLES[n], left_out, axis=0))
    sides = [1, -1, 1] if answer.startswith("bevel_side") else [1, 1, 1]
    assert [row.side for row in prepared.plan.rows] == sides
    if answer == "specimen.column":
        assert [row.specimen for row in prepared.plan.rows] == ["P", "Q", "P"]


def test_needles_of_the_same_names_are_of_several_sheets_or_specimens(tmp_path):
    rows = [["needle", *"xyz"], *long_rows()]
    file = write_sheets(tmp_path / "a.xlsx", **{"Phantom 1": rows, "Phantom 2": rows})
    assert "--set specimen.source=sheet" in refusal(DataError, "Phantom 1, Phantom 2", prepare, [file]).fix
    plan, _ = planned([file], specimen__source="sheet")
    assert [row.specimen for row in plan.rows] == ["Phantom 1"] * 3 + ["Phantom 2"] * 3
    both = [[*rows[0], "specimen"], *([*row, block] for block in "AB" for row in rows[1:])]
    prepared = prepare([write_rows(tmp_path / "b.csv", both)])
    assert [one.name for one in prepared.content.curves] == [f"n{n}-{b}" for b in "AB" for n in range(3)]
    assert "needle" in prepared.mapping.assumed


def test_files_of_one_tool_are_needles_where_that_is_stated(tmp_path):
    files = [
        write_rows(tmp_path / f"run{n}.csv", [["tool", *"xyz"], *(["0A", *point] for point in NEEDLES[n])])
        for n in range(2)
    ]
    assert "--set needle.source=file" in refusal(DataError, "run0.csv", prepare, files).fix
    assert [row.id for row in planned(files, needle__source="file")[0].rows] == ["run0", "run1"]


def test_a_point_list_that_names_the_other_needles_is_asked_about(tmp_path):
    for n, curve in enumerate(NEEDLES):
        write_markups(tmp_path / f"n{n}.mrk.json", f"n{n}", curve)
    listed = tmp_path / "entries.mrk.json"
    write_markups(listed, "entries", np.vstack([one[:2] for one in NEEDLES]), "Fiducial")
    listed.write_text(re.sub(r'"label": "(\d)"', r'"label": "n\1"', listed.read_text()))
    assert "--set leave_out=entries" in refusal(DataError, "entries", prepare, [tmp_path]).fix
    beside = refusal(DataError, "entries", prepare, [tmp_path], leave_out="n2")
    assert "--set leave_out=entries,n2" in beside.fix
    plan, _ = planned([tmp_path], leave_out="entries")
    assert [row.id for row in plan.rows] == ["n0", "n1", "n2"]


@pytest.mark.parametrize("head", ["", "parameter,value,unit\n"])
@pytest.mark.parametrize("signs", [",", ";", "\t", ": "])
def test_the_first_of_names_and_values_may_end_in_a_word_that_is_a_unit(tmp_path, signs, head):
    """`needle gauge` is no unit, and no header: 22G is 0.718 mm."""
    curves = write_rows(tmp_path / "a.csv", [["needle", *"xyz"], *long_rows()])
    lines = ["needle gauge,22G", "modulus,75 GPa", "layer 1 thickness,1 cm", "layer 2 thickness,15 mm"]
    setup = tmp_path / "rig.csv"
    setup.write_text("\n".join([head + lines[0], *lines[1:]]).replace(",", signs))
    plan = prepare([curves, setup], pose="1,0,0").plan
    assert plan.boundaries_mm == {"medium1": (10.0, 25.0)}
    needle = plan.needle
    assert (needle.outer_diameter_mm, needle.youngs_modulus_gpa) == approx((0.718, 75.0), abs=1e-3)


@pytest.mark.parametrize("pose", ["1,0,0", "free"])
def test_a_needle_that_bends_along_what_was_not_measured_is_refused(tmp_path, pose):
    def write(clocks, sd_z):
        z = (lambda k: f"{sd_z * (k % 3)}") if sd_z else (lambda k: "0")
        rows = [
            f"n{n};{clock};{k};{k * k / 900};{z(k)}" for n, clock in enumerate(clocks, 1) for k in range(40)
        ]
        file = tmp_path / f"{len(clocks)}{sd_z}{clocks[0]}.csv"
        file.write_text("\n".join(["needle;bevel clock;x (mm);y (mm);z (mm)", *rows]))
        return planned([file], pose=pose, bevel="0,1,0")[0]

    assert len(write([12, 12, 3], 0.1).rows) == 3
    assert len(write([3, 9, 3], 0).rows) == 3
    refusal(DataError, "n3", write, [12, 6, 3], 0)


@pytest.mark.parametrize(
    ("separator", "make"),
    [
        (";", lambda value: f"{value:,.1f}".translate(str.maketrans(",.", ".,"))),
        (",", lambda value: f'"{value:,.1f}"'),
        (" ", lambda value: f"{value:.8E}".replace("E", "D")),
    ],
)
def test_thousands_and_exponents_of_other_programs(tmp_path, separator, make):
    rows = [[name, *(make(1e3 * value) for value in point)] for name, *point in long_rows()]
    lines = [separator.join(row) for row in [["needle", "x[um]", "y[um]", "z[um]"], *rows]]
    (tmp_path / "a.dat").write_text("\n".join(lines))
    for curve, wanted in zip(curves_of([tmp_path / "a.dat"])[0].values(), NEEDLES, strict=True):
        assert_allclose(curve.line, wanted, atol=1e-4)


# ---- what is assumed, and not used


def test_a_stated_column_is_used(tmp_path):
    rows = [f"{n};{i};{x};{y};{z}" for n, one in enumerate(NEEDLES) for i, (x, y, z) in enumerate(one)]
    (tmp_path / "a.csv").write_text("\n".join(["Serie;t;x;y;z", *rows]))
    assert "needle.column" in refusal(DataError, "", planned, [tmp_path / "a.csv"], holds="shapes").fix
    curves, _ = curves_of([tmp_path / "a.csv"], needle__column="Serie", holds="shapes")
    assert [*curves] == ["0", "1", "2"]
    numbers = {"needle__column": "1", "x__column": "3", "y__column": "5", "z__column": "4", "holds": "shapes"}
    assert_allclose(curves_of([tmp_path / "a.csv"], **numbers)[0]["1"].line, NEEDLES[1][:, [0, 2, 1]])
    refusal(ConfigError, "there is no key", prepare, [tmp_path / "a.csv"], height="2")


# ---- tables of a bench laboratory


def write_plane(path, head, cells=lambda k: (), columns=lambda s, y: (s, y)):
    """Write three needles of a plane, mm: their names, further cells, and columns of depth and deflection."""
    rows = [[f"n{k}", *cells(k), *columns(5.0 * n, 0.01 * k * n**2)] for k in (1, 2, 3) for n in range(9)]
    return write_rows(path, [head, *rows])


def test_an_answer_or_a_change_that_is_refused_is_asked_for_again(tmp_path):
    replies, refused = iter(["perhaps", "1"]), []
    changes = iter(["y.colum=z", "y.column=nothing", "diameter=90G", "diameter=20G", ""])
    prepared = prepare_import(
        [CASES / "matrices.csv"],
        prompt=lambda question, problem: refused.append(problem) or next(replies),
        review=lambda prepared, problem: refused.append(problem) or next(changes),
    )
    assert {curve.kind.name for curve in prepared.content.curves} == {"shapes"} and not [*changes]
    assert [bool(problem) for problem in refused] == [False, True, False, True, True, True, False]
    assert prepared.plan.needle.outer_diameter_mm == GAUGES_MM[20]
    assert "diameter" not in prepared.mapping.assumed and "modulus" in prepared.mapping.assumed


def test_columns_under_unknown_headers_are_asked_for_once_each(tmp_path):
    points = "".join(f"n1,{k},{10 * k},{k * k}\n" for k in range(6))
    (tmp_path / "a.csv").write_text(f"needle,pt,aa_px,row_px\n{points}")
    replies, asked = iter(["aa_px", "row_px", "1 mm"]), []
    prepared = prepare_import(
        [tmp_path / "a.csv"], prompt=lambda question, _: asked.append(question.key) or next(replies)
    )
    assert asked == ["x.column", "y.column", "unit"]
    assert prepared.content.curves[0].line[-1].tolist() == [50, 25, 0]


@pytest.mark.parametrize(("unit", "asked"), [("m", ()), ("", ("diameter.unit=m", "needle_length.unit=m"))])
def test_the_unit_that_a_file_states_is_that_of_its_lengths_and_a_length_of_no_needle_is_asked(
    tmp_path, unit, asked
):
    rows = [
        {"id": f"n{n}", "points": (needle(n) / 1e3).tolist(), "needle_length": 0.15, "diameter": 0.00127}
        for n in (0, 1, 2)
    ]
    file = tmp_path / "shapes.jsonl"
    file.write_text("\n".join(json.dumps(row | ({"unit": unit} if unit else {})) for row in rows))
    stated = {} if unit else {"unit": "m"}
    if asked:
        fix = refusal(DataError, "", planned, [file], **stated).fix
        assert all(option in fix for option in asked)
        stated |= {"diameter__unit": "m", "needle_length__unit": "m"}
    plan, made = planned([file], **stated)
    assert (plan.needle.length_mm, plan.needle.outer_diameter_mm) == approx((150.0, 1.27))
    assert ("diameter.unit" in made) == bool(unit)
