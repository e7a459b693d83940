"""Files of other programs become datasets: what is read, named as not used, assumed, asked for or refused."""

import json
import zipfile
from pathlib import Path

import import_cases
import numpy as np
import pytest
import trimesh
from import_cases import plan_import
from refusals import refusal
from scipy.io import savemat
from test_cli import run

from needlefit.api import score_study
from needlefit.datasets.importing.answers import Answers, Stated
from needlefit.datasets.importing.files import read_content
from needlefit.datasets.importing.synonyms import read_header
from needlefit.datasets.importing.tables import (
    UnclearColumnsError,
    parse_number,
    read_sheets,
    read_text_cells,
)
from needlefit.datasets.planes import measure_out_of_plane
from needlefit.datasets.read import inspect, read
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.curves import integrate_curvature
from needlefit.geometry.surfaces import make_sheet, write_surface
from needlefit.project.locate import read_toml
from needlefit.project.toml import load
from needlefit.reporting.dataset_import import write_import
from needlefit.schemas.scene import SceneRecord, resolve_steps

CASES = Path(__file__).with_name("imports")
CURVES = [import_cases.needle(n, 16 - n) for n in range(3)]
SIDES = {"N1": "1", "N2": "-1", "N3": "1"}


def curves_of(path, columns=""):
    return {one.name: one for one in read_content([path], columns).curves}


def stated(curve):
    return {what: one.text for what, one in curve.stated.items()}


def unused_of(path):
    return {what for what, _ in read_content([path]).unused}


def assert_same(found, wanted=CURVES, atol=1e-3):
    assert len(found) == len(wanted)
    for one, points in zip(found.values(), wanted, strict=True):
        np.testing.assert_allclose(one.points.values, points, atol=atol)


def planned(paths, columns="", **options):
    """Return the plan, and the decisions by name: (value, source)."""
    answers = Answers({key.replace("_", " "): value for key, value in options.items()})
    _, plan = plan_import(paths, answers, columns)
    return plan, {one.what: (one.value, one.source) for one in answers.made}


def points_of(paths, **options):
    """Return the points of the curves, mm, as they are written."""
    content, _ = plan_import(paths, Answers({key.replace("_", " "): text for key, text in options.items()}))
    return [one.points for one in content.curves]


# ---- headers, numbers, units


@pytest.mark.parametrize(
    ("text", "decimal", "value"),
    [
        *(("1,5", ",", 1.5), ("1.234,5", ",", 1234.5), ("-0,25", ",", -0.25), ("\u22123,0", ",", -3.0)),
        *(("1.5", ".", 1.5), ("1e-3", ".", 1e-3), ("1.5", ",", None), ("1,5", ".", None), ("nan", ".", None)),
        *(("1_0", ".", None), ("1e9", ".", None), ("", ".", None), ("12", ",", 12.0)),
    ],
)
def test_numbers_are_read_by_their_decimal_sign(text, decimal, value):
    assert parse_number(text, decimal) == value


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        *(
            ("needle No.", "needle"),
            ("Nadel", "needle"),
            ("aiguille", "needle"),
            ("aguja", "needle"),
            ("针号", "needle"),
        ),
        *(
            ("bevel side", "bevel side"),
            ("Schliff", "bevel side"),
            ("biseau", "bevel side"),
            ("斜面方向", "bevel side"),
        ),
        *(("insertion_depth", "depth"), ("Tiefe [cm]", "depth"), ("profondeur", "depth"), ("深度", "depth")),
        *(("Probe", "specimen"), ("échantillon", "specimen"), ("muestra", "specimen"), ("样本", "specimen")),
        *(("No.", "point number"), ("Zugversuch", ""), ("Schliff oben", "")),
    ],
)
def test_headers_are_known_in_five_languages(text, meaning):
    assert read_header(text).meaning == meaning


@pytest.mark.parametrize(
    ("text", "unit", "angle"),
    [
        *(
            ("1", "", 0),
            ("+", "", 0),
            ("-1", "", 180),
            ("\u22121", "", 180),
            ("up", "", 0),
            ("unten", "", 180),
        ),
        *(
            ("droite", "", 90),
            ("izquierda", "", 270),
            ("下", "", 180),
            ("90 deg", "", 90),
            ("270", "deg", 270),
        ),
        *(("12 o'clock", "", 0), ("6 Uhr", "", 180), ("3h", "", 90), ("9", "clock", 270), ("3点", "", 90)),
        *(("3.14159", "deg", None), ("1.57", "deg", None), ("1.2", "deg", 1.2), ("1.57 deg", "", 1.57)),
        *(("0", "", None), ("2", "", None), ("180", "", None), ("A", "", None), ("13 o'clock", "", None)),
    ],
)
def test_a_bevel_is_understood_or_refused(text, unit, angle):
    """It is never a default."""
    cell = Stated(text, unit, "a.csv:2")
    if angle is None:
        assert refusal(DataError, "bevel side", cell.to_angle).where == "a.csv:2"
    else:
        assert cell.to_angle() == angle


def test_units_are_stated_or_assumed_to_be_mm_where_needles_then_have_a_needles_length(tmp_path):
    rows = ["needle,x,y,z", *(f"{n},{x},{y},{z}" for n, one in enumerate(CURVES) for x, y, z in one)]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    plan, made = planned([tmp_path / "a.csv"])
    assert made["units"] == ("mm", "assumption") and plan.rows[0].depth == pytest.approx(60.02, abs=0.1)
    for text, unit, factor in (("x [cm]", "cm", 10.0), ("x [inch]", "in", 25.4)):
        head = ",".join(["needle", *(text.replace("x", axis) for axis in "xyz")])
        (tmp_path / "a.csv").write_text("\n".join([head, *rows[1:]]))
        plan, made = planned([tmp_path / "a.csv"])
        assert made["units"] == (unit, "file")
        assert plan.rows[0].depth == pytest.approx(60.02 * factor, abs=0.1 * factor)
        plan, made = planned([tmp_path / "a.csv"], units="mm")
        assert made["units"] == ("mm", "option") and plan.rows[0].depth == pytest.approx(60.02, abs=0.1)
    (tmp_path / "a.csv").write_text("\n".join(["needle,x [m],y [m],z [m]", *rows[1:]]))
    refusal(DataError, "--units", planned, [tmp_path])
    (tmp_path / "a.csv").write_text("\n".join(["needle,x [px],y [px],z [px]", *rows[1:]]))
    assert "px" in refusal(DataError, "--units", planned, [tmp_path]).what
    small = [f"{n},{x / 10},{y / 10},{z}" for n, one in enumerate(CURVES) for x, y, z in one]
    (tmp_path / "a.csv").write_text("\n".join([rows[0], *small]))
    assert "6" in refusal(DataError, "--units", planned, [tmp_path]).what


# ---- tables


def test_a_european_table_a_workbook_and_many_markups(tmp_path):
    import_cases.write_european_csv(tmp_path / "six.csv", CURVES)
    found = curves_of(tmp_path / "six.csv")
    assert list(found) == ["Nadel_1", "Nadel_2", "Nadel_3"]
    assert {one.unit for one in found.values()} == {"mm"}
    assert_same(found)
    assert found["Nadel_2"].points.lines[0] == 5
    assert unused_of(tmp_path / "six.csv") == {"row Messung vom 3. März"}
    import_cases.write_workbook(tmp_path / "six.xlsx", CURVES)
    found = curves_of(tmp_path / "six.xlsx")
    assert list(found) == ["Nadel_1", "Nadel_2", "Nadel_3"]
    assert_same(found)
    assert unused_of(tmp_path / "six.xlsx") == {"row Nadelversuch", "sheet Notizen"}
    folder = tmp_path / "markups"
    folder.mkdir()
    for n, curve in enumerate(CURVES):
        import_cases.write_markups(folder / f"{n}.mrk.json", "C", curve, system="RAS" if n else "LPS")
    (folder / "readme.txt").write_text("nothing here")
    content = read_content([folder])
    assert [one.name for one in content.curves] == ["C", "C-2", "C-3"] and len(content.unused) == 1
    assert_same({one.name: one for one in content.curves})


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize(
    ("separator", "decimal"), [(";", ","), ("\t", "."), (",", "."), (" ", ","), (",", ",")]
)
def test_separator_decimal_sign_and_encoding_are_found(tmp_path, encoding, separator, decimal):
    cell = '"{:.3f}"' if separator == decimal else "{:.3f}"
    lines = [separator.join(cell.format(value).replace(".", decimal) for value in row) for row in CURVES[0]]
    (tmp_path / "a.txt").write_bytes("\n".join([separator.join("xyz"), *lines]).encode(encoding))
    assert read_text_cells(tmp_path / "a.txt").decimal == decimal
    assert_same(curves_of(tmp_path / "a.txt"), CURVES[:1])


def test_a_long_table_with_names_and_attributes(tmp_path):
    rows = ["needle;medium;bevel side;i;x [cm];y [cm];z [cm]"]
    for name, curve in zip("ab", CURVES, strict=False):
        rows += [f"{name};gel;-1;{n};" + ";".join(f"{v / 10:.5f}" for v in p) for n, p in enumerate(curve)]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    found = curves_of(tmp_path / "a.csv")
    assert found["a"].unit == "cm" and stated(found["a"]) == {"medium": "gel", "bevel side": "-1"}
    assert_same(found, [curve / 10 for curve in CURVES[:2]])
    assert unused_of(tmp_path / "a.csv") == {"column i"}
    rows[5] = rows[5].replace("gel", "meat")
    (tmp_path / "a.csv").write_text("\n".join(rows))
    assert refusal(DataError, "meat", curves_of, tmp_path / "a.csv").where.endswith("a.csv:6, column 2")


def test_a_column_that_no_language_knows_is_named_by_an_option(tmp_path, capsys):
    file = tmp_path / "a.csv"
    rows = [f"{n};{i};{x};{y};{z}" for n, one in enumerate(CURVES[:2]) for i, (x, y, z) in enumerate(one)]
    file.write_text("\n".join(["Serie;t;x;y;z", *rows]))
    assert_same(curves_of(file, "needle=Serie"), CURVES[:2])
    assert_same(curves_of(file, "needle=1,x=3,y=4,z=5"), CURVES[:2])
    assert unused_of(file) == {"column Serie", "column t"}
    assert run("import", file, "--out", tmp_path / "gel", "--yes") == 3  # one curve that goes back
    assert "--columns needle=" in capsys.readouterr().err
    file.write_text(
        "\n".join(
            ["n,c,a,b,d", *(",".join(map(str, [n, *p[[2, 0, 1]], 7])) for n, p in enumerate(CURVES[0]))]
        )
    )
    for columns in ("a,b,c", "3,4,2", "x=a,y=b,z=c"):
        assert_same(curves_of(file, columns), CURVES[:1])
    assert "--columns" in refusal(UnclearColumnsError, "", curves_of, file).fix
    refusal(DataError, "'q'", curves_of, file, "a,b,q")
    refusal(ConfigError, "--columns", curves_of, file, "height=a,x=b,y=c")
    file.write_text("\n".join(",".join(map(str, point)) for point in CURVES[0]))
    refusal(UnclearColumnsError, "", curves_of, file)
    assert_same(curves_of(file, "1,2,3"), CURVES[:1])
    file.write_text("\n".join(["needle,name,x,y,z", *(f"a,b,{x},{y},{z}" for x, y, z in CURVES[0])]))
    assert "needle=" in refusal(DataError, "needle and name", curves_of, file).fix
    assert list(curves_of(file, "needle=name")) == ["b"]


@pytest.mark.parametrize("title", ["needle {}\nx y z\n", "x y z\n"])
def test_curves_below_each_other(tmp_path, title):
    parts = [title.format(n) + "\n".join(" ".join(map(str, p)) for p in one) for n, one in enumerate(CURVES)]
    (tmp_path / "a.dat").write_text("\n\n".join(parts))
    assert_same(curves_of(tmp_path / "a.dat"))


TWO_ROWS = [["Versuch", "Schliffseite", "Koordinaten [mm]", None, None, "Kraft"], [None, None, *"xyz", "[N]"]]


def write_sheets(path, **sheets):
    from openpyxl import Workbook

    book = Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def point_rows(head=lambda _name, _n: [], tail=()):
    """Return the rows of all curves below each other, with cells before and behind the coordinates."""
    return [
        [*head(name, n), *map(float, point), *tail]
        for name, curve in zip(SIDES, CURVES, strict=True)
        for n, point in enumerate(curve)
    ]


def block_rows():
    for (name, side), curve in zip(SIDES.items(), CURVES, strict=True):
        yield from (["Needle", name], ["bevel", int(side)], ["X (mm)", "Y (mm)", "Z (mm)"])
        yield from (list(map(float, point)) for point in curve)
        yield []


def beside_rows():
    yield [cell for name in SIDES for cell in (name, None, None, None)]
    yield [
        cell for side in SIDES.values() for cell in ("biseau", "haut" if side == "1" else "bas", None, None)
    ]
    yield ["x [mm]", "y [mm]", "z [mm]", None] * 3
    for n in range(len(CURVES[0])):
        points = [list(map(float, one[n])) if n < len(one) else [None] * 3 for one in CURVES]
        yield [cell for point in points for cell in (*point, None)]


LAYOUTS = {
    "two rows, first row of each": {
        "Tabelle1": TWO_ROWS
        + point_rows(lambda name, n: [None, None] if n else [name, "+" if SIDES[name] == "1" else "-"], [0.5])
    },
    "blocks": {"a": [["Protocol", "by me"], *block_rows()]},
    "side by side": {"a": list(beside_rows())},
    "a sheet of needles": {
        "Nadeln": [
            ["Nadel", "Schliff", "Datum"],
            *([name, int(side), "today"] for name, side in SIDES.items()),
        ],
        "Punkte": [["Nadel", "x [mm]", "y [mm]", "z [mm]"], *point_rows(lambda name, _: [name])],
    },
    "a target in every row": {
        "a": [
            ["Trial", "Insertion", "Position (mm)", None, None, "Target (mm)", None, None],
            ["#", "bevel angle (deg)", *"xyz", *"xyz"],
            *point_rows(lambda name, _: [name, 0 if SIDES[name] == "1" else 180], [60.0, 0.0, 0.0]),
        ]
    },
}
LEFT_OUT = {
    "two rows, first row of each": {"column Kraft [N]"},
    "blocks": {"row Protocol, by me"},
    "side by side": set(),
    "a sheet of needles": {"column Datum"},
    "a target in every row": {"row Insertion", *(f"column Target (mm) {axis}" for axis in "xyz")},
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_of_sheets_lose_nothing(tmp_path, layout):
    file = write_sheets(tmp_path / "a.xlsx", **LAYOUTS[layout])
    content = read_content([file])
    found = {one.name: one for one in content.curves}
    assert list(found) == list(SIDES)
    assert_same(found)
    assert {what for what, _ in content.unused} == LEFT_OUT[layout]
    plan, made = planned([file], pose="1,0,0", bevel="0,1,0", bevel_angle="roll")
    assert [row.side for row in plan.rows] == [1, -1, 1]
    assert made["bevel side"][1] == "file" and made["units"] == ("mm", "file")


def test_every_cell_is_used_or_named(tmp_path):
    rows = ["needle,x,y,z,by", *(f"a,{x},{y},{z}," for x, y, z in CURVES[0])]
    rows[4] = "a,MISSING,,nan,"
    rows[7] = "a,,,,"
    rows[9] += "me"
    rows += ["", "mean of all,3.5", "measured on Monday"]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    content = read_content([tmp_path / "a.csv"])
    assert len(content.curves[0].points.values) == len(CURVES[0]) - 2
    assert set(content.unused) == {
        ("column by", "a.csv:1"),
        ("row a, MISSING, nan", "a.csv:5"),
        ("row a", "a.csv:8"),
        ("row mean of all, 3.5", "a.csv:19"),
        ("row measured on Monday", "a.csv:20"),
    }


def test_cells_above_the_points_are_used_or_named_and_digits_are_names(tmp_path):
    """Pairs of cells on Chinese sheets, a needle a sheet, beside a name that no table knows."""
    sheets = {}
    for name, side, curve in (("7", "上", CURVES[0]), ("12", "下", -CURVES[1])):
        sheets[f"Sheet{name}"] = [
            ["针号", name, "斜面方向", side, "操作者", "王"],
            ["进针深度 (毫米)", round(abs(float(curve[-1, 0]))), "样本", "块 1"],
            ["X (毫米)", "Y (毫米)", "Z (毫米)"],
            *(list(map(float, point)) for point in curve),
        ]
    content = read_content([write_sheets(tmp_path / "a.xlsx", **sheets)])
    known = [(one.name, stated(one)) for one in content.curves]
    depths = [{"depth": text, "specimen": "块 1"} for text in ("60", "55")]
    assert known == [("7", {"bevel side": "上"} | depths[0]), ("12", {"bevel side": "下"} | depths[1])]
    assert [what for what, _ in content.unused] == ["row 操作者, 王"] * 2


@pytest.mark.parametrize("version", [5, 7.3])
def test_fields_of_structs_name_curves_and_state_their_bevels(tmp_path, version):
    fields = ("name", "bevel", "depth", "layers", "points", "force")
    rows = [
        (name, float(side), 60.0, 1.0, curve, np.arange(30.0))
        for (name, side), curve in zip(SIDES.items(), CURVES, strict=True)
    ]
    if version == 5:
        array = np.empty(len(rows), dtype=[(name, object) for name in fields])
        array[:] = rows
        savemat(tmp_path / "a.mat", {"needles": array, "rate": 100.0})
    else:
        import_cases.write_struct_array(tmp_path / "a.mat", "needles", fields, rows, rate=100.0)
    content = read_content([tmp_path / "a.mat"])
    found = {one.name: one for one in content.curves}
    assert_same(found)
    assert {name: stated(one)["bevel side"] for name, one in found.items()} == SIDES
    forces = {f"variable needles_{n}_force" for n in (1, 2, 3)}
    assert {what for what, _ in content.unused} == {"field rate", "field layers", *forces}


@pytest.mark.parametrize("order", [(1, 2, 0), (0, 1, 2), None])
def test_curves_of_one_size_may_be_a_stack_or_cells_of_numbers(tmp_path, order):
    curves = [one[:14] for one in CURVES]
    stack = np.array(curves, dtype=object) if order is None else np.transpose(curves, order)
    savemat(tmp_path / "a.mat", {"c": stack})
    assert_same(curves_of(tmp_path / "a.mat"), curves)


# ---- hostile files


@pytest.mark.sweep
def test_a_workbook_that_unpacks_to_gigabytes_or_is_huge_is_refused(tmp_path):
    from openpyxl import Workbook

    with zipfile.ZipFile(tmp_path / "bomb.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        for n in range(40):
            archive.writestr(f"xl/worksheets/sheet{n}.xml", b"\0" * 2**26)
    book = Workbook()
    book.active.cell(900_000, 3, 1.0)
    book.active.cell(1, 1, 1.0)
    book.save(tmp_path / "huge.xlsx")
    (tmp_path / "none.xlsx").write_bytes(b"PK\x03\x04 no archive")
    (tmp_path / "text.xls").write_text("x;y;z")
    for name in ("bomb.xlsx", "huge.xlsx", "none.xlsx", "text.xls"):
        refusal(DataError, name, read_sheets, tmp_path / name)


# ---- what imported files are taken to mean

NEEDLES = [import_cases.needle(n, 16) for n in range(3)]


def write_long(folder, curves, name="points.csv", head=(), cells=()):
    """Write curves `n1`, `n2`, ... to a long table, mm, with more columns before the coordinates."""
    rows = [["needle", *head, "x [mm]", "y [mm]", "z [mm]"]]
    for n, curve in enumerate(curves):
        own = cells[n] if cells else ()
        rows += [[f"n{n + 1}", *own, *(f"{value:.8g}" for value in point)] for point in curve]
    (folder / name).write_text("\n".join(",".join(map(str, row)) for row in rows))
    return folder / name


def with_shaft(curve, step=3.0):
    """Return a needle that begins 18 mm before its entry."""
    x = np.arange(-18.0, -2.0, step)
    return np.vstack([np.column_stack([x, np.full((len(x), 2), curve[0, 1:])]), curve])


def write_surfaces(folder, *names, sign=1.0):
    for name, x in zip(names, (0.0, 20.0, 35.0), strict=False):
        sheet = make_sheet(name, (sign * x, 0.0, 0.0), (1.0, 0.0, 0.0), 90.0, 2)
        write_surface(sheet, folder / f"{name}.stl")


def test_the_entry_is_the_first_point_unless_another_is_stated(tmp_path):
    file = write_long(tmp_path, NEEDLES)
    assert planned([file])[1]["entry"] == ("first", "assumption")
    file = write_long(tmp_path, [one[::-1] for one in NEEDLES])
    np.testing.assert_allclose(points_of([file], entry="last")[1].values, NEEDLES[1], atol=1e-6)
    file = write_long(tmp_path, [NEEDLES[0][::-1], *NEEDLES[1:]])
    assert "n1" in refusal(DataError, "--entry", planned, [file]).what
    assert planned([file], entry="first")[1]["entry"] == ("first", "option")
    file = write_long(tmp_path, [one[::-1] for one in NEEDLES])
    assert "--entry last" in refusal(DataError, "-1,0,0", planned, [file], pose="1,0,0").fix


def test_names_of_digits_stand_above_the_columns_of_their_needles(tmp_path):
    rows = [",".join(map(str, (*a, *b))) for a, b in zip(NEEDLES[0], NEEDLES[1], strict=False)]
    (tmp_path / "a.csv").write_text("\n".join(["1,,,22,,", "x,y,z,x,y,z", *rows]))
    assert [row.id for row in planned([tmp_path])[0].rows] == ["1", "22"] and not unused_of(tmp_path)


def test_a_direction_that_needles_do_not_run_along_is_refused_with_the_measured_one(tmp_path):
    file = write_long(tmp_path, [one[:, [1, 2, 0]] * [1, 1, -1] for one in NEEDLES])
    for wrong in ("0,0,1", "1,0,0", "1,1,-1"):
        assert "0,0,-1" in refusal(DataError, "--pose", planned, [file], pose=wrong).expected
    assert planned([file], pose="0,0,-1")[0].pose == "known"


def test_files_that_state_no_system_are_taken_to_have_that_of_the_others(tmp_path):
    write_surfaces(tmp_path, "skin", "fat")
    import_cases.write_markups(tmp_path / "c.mrk.json", "c", with_shaft(NEEDLES[0]))
    plan, made = planned([tmp_path], pose="shaft", entry_point="skin")
    assert made["frame"] == ("LPS", "assumption") and plan.rows[0].layers == 2
    (tmp_path / "c.mrk.json").unlink()
    write_long(tmp_path, [with_shaft(one) for one in NEEDLES])
    assert planned([tmp_path], pose="shaft", entry_point="skin")[1]["frame"][0] == "as in the files"


def test_a_needle_is_cut_at_a_surface_and_its_shaft_gives_the_pose(tmp_path):
    write_surfaces(tmp_path, "1_skin", "fat", "muscle")
    write_long(tmp_path, [with_shaft(one) for one in NEEDLES])
    plan, _ = planned([tmp_path], point_sd="0.1", pose="shaft", entry_point="1_skin")
    row = plan.rows[1]
    np.testing.assert_allclose(row.entry, [0.0, 3.0, 0.0], atol=0.01)
    np.testing.assert_allclose(row.direction, [1.0, 0.0, 0.0], atol=1e-6)
    assert (row.pose_source, row.layers) == ("first_point", 3)  # a point of the bent needle
    assert [(one.name, one.into) for one in plan.surfaces] == [("fat", 2), ("muscle", 3)]
    x = np.array([*np.arange(-18.0, -2.0, 3.0), 0.0])  # beside the error of a line, that of its bend
    assert 3 * 0.1 / np.linalg.norm(x - x.mean()) < plan.rows[0].pose_angle_sd < np.radians(2.0)
    assert plan.rows[0].pose_shift_sd == 0.1
    options = {"pose": "shaft", "entry_point": "1_skin", "pose_angle_sd": "1"}
    assert np.degrees(planned([tmp_path], **options)[0].rows[0].pose_angle_sd) == pytest.approx(1.0)
    assert len(planned([tmp_path], entry_point="first", pose="1,0,0")[0].surfaces) == 3
    refusal(DataError, "--entry-point", planned, [tmp_path], pose="1,0,0")  # is the first surface a skin?
    refusal(DataError, "--pose", planned, [tmp_path])
    refusal(DataError, "--pose", planned, [tmp_path], pose="free")


def test_a_skin_whose_entry_face_is_missing_is_named(tmp_path):
    write_long(tmp_path, NEEDLES)
    box = trimesh.creation.box(bounds=[[0.0, -15.0, -15.0], [30.0, 15.0, 15.0]])  # needles leave it at 30 mm
    box.update_faces(box.face_normals[:, 0] > -0.5)
    box.export(tmp_path / "skin.stl")
    fault = refusal(DataError, "", planned, [tmp_path], pose="1,0,0", entry_point="skin")
    assert "skin.stl" in str(fault) and "hole" in str(fault)


@pytest.mark.parametrize("by", ["entry point", "depth", "label"])
def test_a_straight_shaft_is_cut_at_the_stated_entry_or_depth(tmp_path, by):
    curves = [with_shaft(NEEDLES[0] + [0, 5.0 * n, 0]) for n in range(3)]
    # of an arc with its first points on a line; along the needle the depth is that of the part in the tissue
    depth = float(np.sum(np.linalg.norm(np.diff(NEEDLES[0], axis=0), axis=1)))
    head, cells = (["depth [cm]"], [[f"{depth / 10:.4f}"]] * 3) if by == "depth" else ((), ())
    file = write_long(tmp_path, curves, head=head, cells=cells)
    if by == "label":
        file.write_text(f"Tiefe,{depth / 10:.4f} cm\n\n" + file.read_text())
    options = {"entry_point": "0,0,0"} if by == "entry point" else {}
    if by == "entry point":
        file = write_long(tmp_path, [with_shaft(one - one[0]) for one in NEEDLES])
    plan, made = planned([file], pose="shaft", **options)
    for row, points in zip(plan.rows, points_of([file], pose="shaft", **options), strict=True):
        np.testing.assert_allclose(row.direction, [1, 0, 0], atol=1e-6)
        assert row.pose_source == ("shaft" if by == "entry point" else "first_point")
        assert abs(points.values[0, 0]) < 0.01
    assert made["entry point"][0] == ("0,0,0" if by == "entry point" else "depth")
    assert "18.0 mm" in made["shaft"][0]


@pytest.mark.parametrize(("spacing", "noise"), [(5.0, 0.2), (1.0, 0.2), (0.5, 0.1), (0.1, 0.2)])
def test_dense_and_noisy_points_are_as_long_as_their_needles(tmp_path, spacing, noise):
    """Arcs of 35 to 60 mm; a stated depth is used as it stands."""
    rng, depths = np.random.default_rng(8), np.arange(35.0, 61.0, 5.0)
    curves = []
    for depth in depths:
        s = np.linspace(0.0, depth, round(depth / spacing) + 1)
        arc = np.column_stack([integrate_curvature(depth, [0.008], s), np.zeros(len(s))])
        curves.append(arc + noise * rng.normal(size=arc.shape))
    answers = {"pose": "1,0,0", "point_sd": f"{noise}"}
    plan, _ = planned([write_long(tmp_path, curves)], **answers)
    gaps = np.array([row.depth for row in plan.rows]) - depths
    sds = np.array([row.depth_sd for row in plan.rows])
    assert (np.abs(gaps) < 3.5 * sds).all() and (sds < (2.0 if spacing > 1 else 1.0) * noise).all()
    cells = [[f"{depth:g}"] for depth in depths]
    plan, _ = planned([write_long(tmp_path, curves, head=["depth [mm]"], cells=cells)], **answers)
    assert [(row.depth, row.depth_sd) for row in plan.rows] == [(depth, 0.0) for depth in depths]


def test_a_shaft_of_two_points_before_the_entry_gives_the_direction(tmp_path):
    """Eight points a needle, 10 mm apart, 20 mm of them outside the tissue."""
    x = np.arange(-20.0, 60.0, 10.0) - 2.0
    curves = [np.column_stack([0.02 * x, x, s * 8e-4 * np.maximum(x, 0.0) ** 2]) for s in (1, -1)]
    file = write_long(tmp_path, curves, head=["bevel"], cells=[["1"], ["-1"]])
    plan, made = planned([file], pose="shaft", entry_point="0,0,0")
    assert made["bevel"][1] == "guess" and made["shaft"][0].startswith("22.0 to 22.0 mm")
    for row in plan.rows:
        np.testing.assert_allclose(
            row.direction, np.array([0.02, 1.0, 0.0]) / np.hypot(1.0, 0.02), atol=0.003
        )
        assert row.depth == pytest.approx(48.0, abs=0.2)
    _, made = planned([file])
    assert made["pose"][0] == "free"
    asked = {}
    plan_import([file], Answers({}, lambda what, guess, reason: asked.setdefault(what, reason) and ""))
    assert "--pose 0,1,0 " in asked["pose"]


def test_a_shaft_without_an_entry_a_depth_or_enough_points_is_refused(tmp_path):
    file = write_long(tmp_path, [with_shaft(one) for one in NEEDLES])
    refusal(DataError, "--entry-point", planned, [file], pose="shaft")
    refusal(DataError, "--pose", planned, [file], pose="shaft", entry_point="-17,0,0")
    refusal(DataError, "--entry-point", planned, [file], pose="shaft", entry_point="depth")
    refusal(DataError, "behind its entry", planned, [file], pose="shaft", entry_point="60,1,0")


def test_a_stated_depth_must_be_the_length_of_its_curve(tmp_path):
    file = write_long(tmp_path, NEEDLES[:1], head=["depth"], cells=[["30"]])
    error = refusal(DataError, "60.0 mm long", planned, [file])
    assert "--entry-point" in error.fix
    plan, _ = planned([file], entry_point="depth")
    assert plan.rows[0].depth == pytest.approx(30.0)
    assert planned([write_long(tmp_path, NEEDLES[:1], head=["depth"], cells=[["61"]])])[0].pose == "free"
    file = write_long(tmp_path, NEEDLES[:1], head=["depth"], cells=[["80"]])
    assert refusal(DataError, "'80'", planned, [file]).where.endswith("points.csv:2, column 2")


def test_a_stated_direction_leaves_the_entry_and_its_errors_to_be_decided(tmp_path):
    file = write_long(tmp_path, NEEDLES)
    plan, made = planned([file], pose="1,0,0", point_sd="0.03")
    assert made["entry point"] == ("first", "assumption") and made["pose shift sd"] == ("0.03", "guess")
    assert made["pose angle sd"] == ("0.5", "assumption")
    row = plan.rows[1]
    np.testing.assert_allclose(row.entry, NEEDLES[1][0], atol=1e-6)
    assert (row.pose_shift_sd, np.degrees(row.pose_angle_sd)) == (0.03, pytest.approx(0.5))
    # the first point has moved with the needle
    assert row.pose_source == "first_point" and made["shift across"] == ("fitted", "file")
    answers = {"entry_point": "0,0,0", "pose_shift_sd": "0", "pose_angle_sd": "0,2"}
    plan, made = planned([file], pose="2,0,0", **answers)
    row = plan.rows[1]
    np.testing.assert_array_equal(row.entry, np.zeros(3))
    assert row.pose_source == "stage" and "shift across" not in made
    assert (row.pose_shift_sd, np.degrees(row.pose_angle_sd)) == (0.0, pytest.approx(0.2))
    assert {made[name][1] for name in ("entry point", "pose shift sd", "pose angle sd")} == {"option"}


def test_boundaries_are_stated_as_depths(tmp_path):
    file = write_long(tmp_path, NEEDLES)
    plan, _ = planned([file], pose="1,0,0", boundaries="15,5;52,0", boundary_sd="0.3")
    assert plan.boundaries_mm == {"medium1": (15.5, 52.0)}
    assert [row.layers for row in plan.rows] == [3, 3, 2]
    assert {row.boundary_sd for row in plan.rows} == {0.3}
    assert planned([file], boundaries="15,52")[1]["boundary sd"] == ("0.5", "assumption")
    assert planned([file])[1]["boundaries"] == ("none", "assumption")


@pytest.mark.parametrize(
    ("stated", "doubted"), [("3", 1), ("3,40", 1), ("2,3,50", 1), ("15", 0), ("5,40", 0)]
)
def test_a_boundary_that_may_be_in_centimetres_is_an_assumption(tmp_path, stated, doubted):
    _, made = planned([write_long(tmp_path, NEEDLES)], boundaries=stated)
    assert ("boundary unit" in made) == doubted
    assert not doubted or made["boundary unit"] == ("mm", "assumption")


# ---- bevels


def test_a_bevel_that_is_not_understood_or_missing_is_stated_by_needle_or_cell(tmp_path):
    answers = {"pose": "1,0,0", "bevel": "0,1,0"}
    file = write_long(tmp_path, NEEDLES, head=["Schliff"], cells=[["A"], ["B"], ["A"]])
    assert refusal(DataError, "'A'", planned, [file], **answers).where.endswith(":2, column 2")
    plan, made = planned([file], bevel_side="unten", **answers)
    assert [row.side for row in plan.rows] == [-1] * 3 and made["bevel side"] == ("unten", "option")
    file = write_long(tmp_path, NEEDLES, head=["Schliff"], cells=[["1"], [""], ["-1"]])
    assert "n2" in refusal(DataError, "--bevel-side", planned, [file], **answers).what
    plan, _ = planned([file], bevel_side="-1", **answers)
    assert [row.side for row in plan.rows] == [1, -1, -1]
    file = write_long(tmp_path, NEEDLES, head=["Schliff"], cells=[["1"], ["-1"], ["1"]])
    assert "n2" in refusal(DataError, "--bevel", planned, [file], pose="1,0,0").what
    file = write_long(tmp_path, NEEDLES)
    assert planned([file], **answers)[1]["bevel side"] == ("1", "assumption")
    assert planned([file])[1]["bevel"] == ("bend", "assumption")


def test_a_clock_position_is_a_side_or_another_plane():
    answers = {"pose": "1,0,0", "bevel": "0,1,0"}
    plan, made = planned([CASES / "clock.csv"], **answers)
    bevels = {row.id: (row.bevel * row.side).round(6).tolist() for row in plan.rows}
    assert bevels == {"a": [0, 1, 0], "b": [0, -1, 0], "c": [0, 0, 1]}
    assert made["bevel side"] == ("12 o'clock, 6 o'clock, 3 o'clock", "file")
    refusal(DataError, "--bevel", planned, [CASES / "clock.csv"], pose="1,0,0")  # c bends as a does


# ---- turns on the way, and curvatures

TURNS = "id,depth_mm,bevel_roll_deg\n" + "".join(f"q{n},{25 + 5 * n},90\n" for n in range(1, 5))
CURVATURES = "Nadel;s (cm);Krümmung y [1/m];kappa_z [1/m];sd [1/m]\nq1;1;0,1;3,3;0,1\nq1;4;3,3;-0,2;0,1\n"
SHARP = {
    "pose": "1,0,0",
    "entry_point": "0,0,0",
    "bevel": "0,1,0",
    "point_sd": "0.05",
    "pose_angle_sd": "0.05",
}


def import_turned(folder, turns=TURNS, **answers):
    """Import the four needles with their turns; return the folder of the dataset."""
    (folder / "turns.csv").write_text(turns)
    paths = [CASES / "two_plane.csv", folder / "turns.csv"]
    settled = Answers({key.replace("_", " "): value for key, value in answers.items()})
    content, plan = plan_import(paths, settled)
    write_import(folder / "gel", content, plan, settled)
    return folder / "gel"


def test_tables_of_turns_and_curvatures_belong_to_needles_of_their_names(tmp_path):
    (tmp_path / "turns.csv").write_text(TURNS)
    (tmp_path / "bragg.csv").write_text(CURVATURES)
    paths = [CASES / "two_plane.csv", tmp_path]
    assert "--pose 1,0,0" in refusal(DataError, "pose", planned, paths).what
    refusal(DataError, "turn", planned, paths, pose="1,0,0", bevel="bend")
    plan, made = planned(paths, pose="1,0,0")
    toward = [float(text) for text in made["bevel"][0].split(",")]  # as they bend before they are turned
    assert made["bevel"][1] == "guess" and toward == pytest.approx([0, 1, 0], abs=0.03)
    assert made["turns"][1] == made["curvatures"][1] == "file"
    assert made["bevel roll sd"] == ("5", "assumption")
    assert [np.degrees(row.turns).tolist()[0][1] for row in plan.rows] == pytest.approx([90.0] * 4)
    assert plan.rows[2].turns[0][0] == 40.0 and plan.rows[1].curvature is None
    wanted = [[10, 1e-4, 3.3e-3, 1e-4], [40, 3.3e-3, -2e-4, 1e-4]]
    np.testing.assert_allclose(plan.rows[0].curvature, wanted, atol=1e-9)
    # from up, where bevels that face right have their roll of 0
    plan, _ = planned(paths, pose="1,0,0", bevel="0,1,0", bevel_side="90 deg")
    np.testing.assert_allclose(plan.rows[0].curvature[0], [10, 3.3e-3, -1e-4, 1e-4], atol=1e-9)
    assert plan.rows[0].turns[0][1] == pytest.approx(0.0) and plan.rows[0].bevel == pytest.approx([0, 0, 1])


@pytest.mark.parametrize(
    ("text", "place", "reason"),
    [
        ("id,depth_mm,bevel_roll_deg\nq1,30,\n", 2, "bevel side"),
        ("id,turn depth,roll\nq1,30,sideways\n", 0, "sideways"),
        ("id,s_mm,kappa_y_1_per_mm,sd_1_per_mm\nq1,30,1e-3,1e-4\n", 1, "curvature z"),
        ("id,s_mm,kappa_y,kappa_z,sd\nq1,30,1e-3,much,1e-4\n", "2, column 4", "much"),
        ("id,s_mm,kappa_y [1/ft],kappa_z,sd\nq1,30,1e-3,0,1e-4\n", "1, column 3", "ft"),
    ],
)
def test_a_bad_row_of_turns_or_curvatures_stops_the_import_at_its_place(tmp_path, text, place, reason):
    (tmp_path / "beside.csv").write_text(text)
    error = refusal(DataError, reason, planned, [CASES / "two_plane.csv", tmp_path], **SHARP)
    assert not place or error.where.endswith(f"beside.csv:{place}")


def test_needles_that_were_turned_are_fitted_by_the_path_angle_and_missed_by_less_than_0_3_mm(tmp_path):
    """Two arcs of one curvature at right angles, of no model."""
    folder = import_turned(tmp_path, **SHARP)
    found = score_study(f"{folder}/gel_study.toml", jobs=1)
    errors = found[found["method"] == "fitted"].groupby("role")["te_mm"].mean()
    assert errors.max() < 0.2 and {*errors.index} == {"tune", "validate"}
    # the scene of the deepest needle, to be predicted, turns as that did
    steps = resolve_steps(load(folder / "scene.toml", SceneRecord))
    assert [step.depth_mm for step in steps] == pytest.approx([45.0, 90.851], abs=1e-3)
    assert [step.bevel.roll_deg or 0.0 for step in steps] == pytest.approx([0.0, 90.0])


@pytest.mark.parametrize(
    ("signs", "named"), [((1, 1), []), ((-1, 1), ["y"]), ((1, -1), ["z"]), ((-1, -1), ["y", "z"])]
)
def test_curvatures_of_the_wrong_sign_are_named_with_their_column(tmp_path, signs, named):
    """Two arcs of a radius of 300 mm: toward +y up to half the depth, then toward +z."""
    folder, rows = import_turned(tmp_path, **SHARP), ["id,s_mm,kappa_y_1_per_mm,kappa_z_1_per_mm,sd_1_per_mm"]
    for one in read(folder).insertions:
        for part, y, z in ((0.9, 1, 0), (0.6, 1, 0), (0.4, 0, 1), (0.1, 0, 1)):
            rows.append(
                f"{one.id},{part * one.depth:.2f},{signs[0] * y / 300:.6f},{signs[1] * z / 300:.6f},1e-4"
            )
    (folder / "curvature.csv").write_text("\n".join(rows))
    stated = (
        (folder / "dataset.toml").read_text().replace('turns = "', 'curvature = "curvature.csv"\nturns = "')
    )
    (folder / "dataset.toml").write_text(stated)
    found = [one.what for one in inspect(folder).warnings if one.kind == "curvature"]
    assert [next(axis for axis in "yz" if f"kappa_{axis}" in what) for what in found] == [*named]


def test_needles_whose_turns_are_not_stated_are_said_to_leave_their_plane(tmp_path):
    settled = Answers({"pose": "1,0,0", "bevel": "0,1,0"})
    content, plan = plan_import([CASES / "two_plane.csv"], settled)
    dataset = write_import(tmp_path / "gel", content, plan, settled)
    away = {name: mm for name, mm, _ in measure_out_of_plane(dataset)}
    assert [away[f"q{n}"] for n in range(1, 5)] == pytest.approx([1.5, 2.2, 2.7, 3.4], abs=0.1)
    assert "bevel_plane" in {one.kind for one in inspect(tmp_path / "gel").warnings}
    # a turn that is stated later is fitted as one that was imported
    assert read_toml(tmp_path / "gel/tissue.toml")["advance"] == "path_angle"


@pytest.mark.parametrize(("roll", "aside"), [(90, False), (45, False), (0, True), (180, True), (-90, True)])
def test_needles_are_judged_beside_the_turns_that_are_stated(tmp_path, roll, aside):
    """They were turned by 90 degrees: in a table of turns, as without one, another turn is wrong."""
    turns = TURNS.replace(",90", f",{roll}").replace("id,", "needle,")
    dataset = read(import_turned(tmp_path, turns, pose="1,0,0", bevel="0,1,0"))
    assert ("bevel_plane" in {one.kind for one in dataset.warnings}) == aside
    away = {name: mm for name, mm, _ in measure_out_of_plane(dataset)}
    wanted = [1.5, 2.2, 2.7, 3.4] if aside else [0.0] * 4
    assert [away[f"q{n}"] for n in range(1, 5)] == pytest.approx(wanted, abs=0.15)
    (fix,) = (one.fix for one in dataset.warnings if one.kind == "bevel_plane") if aside else ("",)
    assert ("`bevel_roll_deg`" in fix) == (roll == -90)


# ---- tip tracks and structure sets


def test_a_log_of_tip_poses_is_a_track_and_not_the_shape_of_one_needle(tmp_path):
    out = tmp_path / "em"
    lines = (CASES / "em.csv").read_text().splitlines()
    lines[4] = lines[4].replace("15.030,0.259,0.016", "MISSING,MISSING,MISSING")
    (tmp_path / "em.csv").write_text("\n".join(lines))
    plan, made = planned([tmp_path / "em.csv"])
    assert made["observable"] == ("tracks", "guess") and plan.pose == "tracker"
    unused = unused_of(tmp_path / "em.csv")
    assert {"row 15.0, MISSING, MISSING, MISSING", "column base_x", "column qw"} < unused
    assert run("import", tmp_path / "em.csv", "--out", out, "--bevel", "0,1,0", "--setup", "medium=gel") == 0
    dataset = read(out)
    (track,) = dataset.insertions
    assert (dataset.pose, track.id, track.medium) == ("tracker", "em", "gel")
    assert track.points[:, 0].tolist() == [0.0, 5.0, 10.0, *np.arange(20.0, 61.0, 5.0)]
    assert track.points[[0, -1], 1] == pytest.approx([0.086, 2.978]) and not track.guide.y.any()
    assert np.ptp(track.points[:, 2]) > 0 and not track.guide.z.any()
    assert {path.name for path in out.iterdir()} == {"dataset.toml", "tracks.csv"}
    shape, _ = planned([tmp_path / "em.csv"], observable="shapes")
    assert shape.pose == "free" and len(points_of([tmp_path / "em.csv"], observable="shapes")[0].values) == 12


def test_a_log_without_depth_or_a_depth_in_each_row_alone_is_asked_about(tmp_path):
    rows = [f"{n},{x},{y},{z}" for n, (x, y, z) in enumerate(NEEDLES[0])]
    for head in ("time", "depth"):
        (tmp_path / "a.csv").write_text("\n".join([f"{head},x [mm],y [mm],z [mm]", *rows]))
        refusal(DataError, "--observable", planned, [tmp_path])
        assert planned([tmp_path], observable="shapes")[0].pose == "free"
    assert planned([tmp_path], observable="tracks")[0].pose == "tracker"
    (tmp_path / "a.csv").write_text("\n".join(["time,x [mm],y [mm],z [mm]", *rows]))
    assert planned([tmp_path], observable="tracks")[1]["depth"] == ("along 1,0,0", "assumption")
    assert planned([tmp_path], "depth=x [mm]", observable="tracks")[0].pose == "tracker"


@pytest.mark.parametrize("sides", [(1, 1), (1, -1)])
def test_the_bevel_of_logs_is_across_the_needle_and_asked_for_where_tips_bend_to_several_sides(
    tmp_path, sides
):
    """As a tracker of NDI writes them: far from the origin, with a row without coordinates."""
    depths, noise = np.arange(0.0, 75.0, 6.0), np.random.default_rng(5)
    rows = []
    for run_, side in enumerate(sides):
        tips = np.column_stack([100 + depths, side * depths**2 / 520, -40 + 0 * depths])
        tips += noise.normal(0.0, 0.1, tips.shape)
        rows += [f"r{run_},{n},{x},{y},{z},1,{6 * n}" for n, (x, y, z) in enumerate(tips)]
    rows[4] = "r0,4,MISSING,MISSING,MISSING,1,24.0"
    (tmp_path / "log.csv").write_text("\n".join(["run,Frame,Tx,Ty,Tz,Q0,Depth [mm]", *rows]))
    if sides[1] < 0:
        refusal(DataError, "--bevel", planned, [tmp_path])
        return
    _, made = planned([tmp_path])
    assert made["bevel side"] == ("1", "assumption") and len(unused_of(tmp_path)) == 3
    for points in points_of([tmp_path], observable="tracks"):
        assert np.ptp(points.values[:, 0]) == pytest.approx(depths[-1] ** 2 / 520, abs=0.4)


@pytest.mark.parametrize(
    "names", [("Insertion depth (mm)", "Tip deflection (mm)"), ("Stichtiefe", "Auslenkung")]
)
def test_a_table_of_depth_and_deflection_is_a_track(tmp_path, names):
    depths = np.arange(0.0, 75.0, 15.0)
    rows = [f"{name};{x};{k * 1e-3 * x**2:.4f}" for k, name in enumerate("pq", 1) for x in depths]
    (tmp_path / "a.csv").write_text("\n".join([";".join(["run", *names]), *rows]))
    _, made = planned([tmp_path])
    assert made["observable"] == ("tracks", "guess")
    assert run("import", tmp_path, "--out", tmp_path / "t", "--setup", "specimen=one") == 0
    tracks = read(tmp_path / "t").insertions
    assert [(one.id, one.specimen) for one in tracks] == [("p", "one"), ("q", "one")]
    for k, one in enumerate(tracks, 1):
        np.testing.assert_allclose(one.points[:, 0], depths)
        np.testing.assert_allclose(one.points[:, 1], k * 1e-3 * depths**2, atol=1e-4)


def test_open_contours_of_a_structure_set_are_centrelines(tmp_path):
    found = curves_of(CASES / "needles_rs.dcm")
    assert list(found) == [f"Needle_{n}" for n in range(1, 5)]
    assert {len(one.points.values) for one in found.values()} == {15}
    assert {(one.unit, one.system) for one in found.values()} == {("mm", "LPS")}
    np.testing.assert_allclose(found["Needle_2"].points.values[0], [5, 10, 0])
    assert planned([CASES / "needles_rs.dcm"], pose="0,0,-1")[0].rows[0].depth == pytest.approx(70.1, abs=0.1)
    data = (CASES / "needles_rs.dcm").read_bytes()
    (tmp_path / "closed.dcm").write_bytes(data.replace(b"OPEN_NONPLANAR", b"CLOSED_PLANAR "))
    refusal(DataError, "open contour", read_content, [tmp_path / "closed.dcm"])
    (tmp_path / "no.dcm").write_bytes(b"x" * 300)
    refusal(DataError, "structure set", read_content, [tmp_path / "no.dcm"])


# ---- the workbook, answers, questions


def test_the_workbook_to_fill_in_is_read(tmp_path):
    file = tmp_path / "own.xlsx"
    assert run("new", "workbook", file) == 0
    assert run("new", "workbook", file) == 3
    content = read_content([file])
    assert [one.name for one in content.curves] == [f"n{n}" for n in range(1, 9)]
    known = {"bevel side", "depth", "specimen", "medium"}
    assert all({*one.stated} == known for one in content.curves)
    assert [what for what, _ in content.unused] == ["sheet points", "sheet needles"]
    _, made = planned([file], point_sd="0.2", units="mm")
    assert (made["point sd"], made["pose angle sd"]) == (("0.2", "option"), ("0.1", "file"))
    assert "assumption" not in {source for _, source in made.values()}


def test_a_unit_may_stand_in_the_name_of_an_answer(tmp_path):
    points = [["x (mm)", "y (mm)", "z (mm)"], *CURVES[0].tolist()]
    setup = [["name", "value", "unit"], ["boundaries [cm]", "2; 4"], ["Needle_length (m)", 0.2, "m"]]
    file = write_sheets(tmp_path / "a.xlsx", points=points, setup=setup)
    plan, made = planned([file])
    assert plan.boundaries_mm == {"medium1": (20.0, 40.0)} and plan.needle.length_mm == pytest.approx(200.0)
    assert "not used" not in made
    rows = ["boundaries [cm];2;4", "Nadeldurchmesser: 0,9 mm", "x [mm];y [mm];z [mm]"]
    rows += [";".join(f"{one:.3f}".replace(".", ",") for one in point) for point in CURVES[0]]
    (tmp_path / "above.csv").write_text("\n".join(rows))
    plan, made = planned([tmp_path / "above.csv"])
    assert plan.boundaries_mm == {"medium1": (20.0, 40.0)} and plan.needle.outer_diameter_mm == 0.9
    assert made["boundaries"] == ("2; 4 cm", "file") and "not used" not in made
    file = write_sheets(tmp_path / "b.xlsx", points=points, setup=[*setup, ["point sd [mm]", 1, "cm"]])
    assert refusal(DataError, "one unit", planned, [file]).where.endswith("row 4, column 2")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        *(({"pose": "1,2"}, "--pose"), ({"entry": "middle"}, "--entry"), ({"modulus": "wood"}, "modulus=")),
        *(({"diameter": "99G"}, "diameter="), ({"inner_diameter": "2"}, "inner diameter=")),
        *(({"boundaries": "30,15"}, "--boundaries"), ({"boundaries": "deep"}, "--boundaries")),
        *(({"units": "px"}, "--units"), ({"point_sd": "1 deg"}, "--point-sd")),
        ({"pose": "1,0,0", "pose_angle_sd": "-1"}, "pose angle sd="),
        ({"pose": "1,0,0", "entry_point": "last"}, "--entry-point"),
    ],
)
def test_options_that_mean_nothing_are_refused(tmp_path, options, reason):
    error = refusal(DataError, "", lambda: planned([write_long(tmp_path, NEEDLES)], **options))
    assert reason in error.fix


def test_questions_are_asked_with_a_guess_and_faults_named_at_their_place(tmp_path):
    asked = {}

    def prompt(what, guess, _):
        asked[what] = guess
        return {"modulus": "acero", "diameter": "20G", "medium": "gel"}.get(what, "")

    answers = Answers({"inner diameter": "0.5"}, prompt)
    _, plan = plan_import([write_long(tmp_path, NEEDLES)], answers)
    assert asked["modulus"] == "steel" and not {"inner diameter", "title"} & asked.keys()
    assert (plan.needle.youngs_modulus_gpa, plan.needle.outer_diameter_mm) == (200.0, 0.908)
    sources = {one.what: one.source for one in answers.made}
    assert (sources["medium"], sources["point sd"]) == ("answer", "assumption")
    folded = NEEDLES[0].copy()
    folded[[6, 9]] = folded[[9, 6]]
    file = write_long(tmp_path, [folded])
    error = refusal(DataError, "", planned, [file])
    assert error.where == f"{file}:9" and "order=nearest" in error.fix
    assert points_of([file], order="nearest")[0].lines[[6, 9]].tolist() == [11, 8]


# ---- several files


def test_a_table_of_needles_belongs_to_curves_of_their_names(tmp_path):
    import_cases.write_european_csv(tmp_path / "points.csv", CURVES)
    rows = ["Nadel;Tiefe", "Nadel 1;61", "Nadel 2;62", "Nadel_3;63", "4;64", ";9"]
    (tmp_path / "info.csv").write_text("\n".join(rows))
    content = read_content([tmp_path])
    assert [stated(one)["depth"] for one in content.curves] == ["61", "62", "63"]
    left = {("row of needle 4", "info.csv:5, column 1"), ("row 9", "info.csv:6")}
    assert left == content.doubts.keys() and left < set(content.unused)
    (tmp_path / "more.csv").write_text("Nadel;Schliff\nNadel 1;-1\n")
    assert stated(read_content([tmp_path]).curves[0]) == {"depth": "61", "bevel side": "-1"}
    (tmp_path / "more.csv").write_text("Nadel;Schliff;Tiefe\nNadel 1;-1;99")
    refusal(DataError, "'61'", read_content, [tmp_path])


def test_a_bad_cell_of_a_sheet_stops_the_import_at_its_cell(tmp_path):
    head = [["X (mm)", "Y (mm)", "Z (mm)"]]
    good, bad = [[[None, *row] for row in head + CURVES[n].tolist()] for n in (0, 1)]
    bad[2][2] = None
    sheets = {"Ins0": good, "Ins1": [[], *bad], "Ins2": []}
    file = write_sheets(tmp_path / "a.xlsx", **sheets)
    assert refusal(DataError, "", read_content, [file]).where.endswith("sheet Ins1, row 4, column 3")
    file = write_sheets(tmp_path / "a.xlsx", **sheets | {"Ins1": good, "Ins3": [["by", "me"]]})
    content = read_content([file])
    assert [one.name for one in content.curves] == ["Ins0", "Ins1"]
    assert {what for what, _ in content.unused} == {"sheet Ins2", "sheet Ins3"}


# ---- the dataset


@pytest.mark.sweep
def test_the_command_writes_a_dataset_that_check_passes(tmp_path, capsys):
    import_cases.write_european_csv(tmp_path / "six.csv", NEEDLES)
    assert (
        run("import", tmp_path / "six.csv", "--out", tmp_path / "gel", "--setup", "modulus=steel", "--json")
        == 0
    )
    shown = json.loads(capsys.readouterr().out)
    assert [one["insertion"] for one in shown["insertions"]] == ["Nadel_1", "Nadel_2", "Nadel_3"]
    found = inspect(tmp_path / "gel")
    assert not found.faults and {one.kind for one in found.warnings} == {"placeholder", "assumed", "noise"}
    assert (tmp_path / "gel" / "import.png").stat().st_size > 10_000
    stored = read_toml(tmp_path / "gel" / "dataset.toml")["import"]
    assert stored["decisions"] == shown["decisions"] and list(stored["files"]) == ["six.csv"]
    assert run("import", tmp_path / "six.csv", "--out", tmp_path / "again", "--setup", "modulus=steel") == 0
    one, other = (sorted((tmp_path / name).rglob("*.[cp]*")) for name in ("gel", "again"))
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]


def test_a_study_of_an_import_works_from_another_folder_and_moves_with_its_data(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    write_long(Path(), NEEDLES)
    assert run("import", "points.csv", "--out", "gel", "--pose", "1,0,0", "--bevel", "0,1,0") == 0
    (tmp_path / "there").mkdir()
    Path("gel").rename(tmp_path / "there" / "moved")
    monkeypatch.chdir(tmp_path)
    for study in ("there/moved/gel_study.toml", tmp_path / "there/moved/gel_study.toml"):
        assert run("check", f"./{study}" if isinstance(study, str) else study) == 0


@pytest.mark.parametrize("text", ["", "hello\n", "1,2,3\n", "x,y,z\n1,2,3\n4,a,6\n7,8,9\n1,2,3\n", "x,x,x\n"])
def test_bad_input_ends_in_exit_code_3_and_writes_nothing(tmp_path, text, capsys):
    (tmp_path / "a.csv").write_text(text)
    assert run("import", tmp_path / "a.csv", "--out", tmp_path / "gel") == 3
    assert run("import", tmp_path / "none.xlsx", "--out", tmp_path / "gel") == 3
    assert run("import", tmp_path, "--out", tmp_path / "gel") == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv"]
    assert "a.csv" in capsys.readouterr().err
    (tmp_path / "dataset.toml").touch()
    for path in (tmp_path, tmp_path / "dataset.toml"):
        assert str(tmp_path / "dataset.toml") in refusal(DataError, "", read_content, [path]).fix
