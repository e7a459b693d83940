"""Files of other programs are read as the curves and surfaces that they hold."""

import json
import zipfile

import import_cases
import numpy as np
import pytest
from import_cases import plan_import
from refusals import refusal
from scipy.io import savemat

from needlefit.cli import main
from needlefit.datasets.importing import files
from needlefit.datasets.importing.conversion import write_plan
from needlefit.datasets.importing.decisions import Decisions
from needlefit.datasets.importing.files import read_content
from needlefit.datasets.importing.tables import parse_number, read_sheets, read_text_cells
from needlefit.datasets.read import check_all, read
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.surfaces import make_cylinder, make_sheet, read_surface, write_surface
from needlefit.project.toml import load, read_toml
from needlefit.schemas.dataset import DatasetRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.studies.provenance import describe_dataset
from needlefit.studies.study_files import load_study

CURVES = [import_cases.needle(n, 16 - n) for n in range(3)]


def curves_of(path, columns=()):
    return {one.name: one for one in read_content([path], columns).curves}


def assert_same(found, wanted=CURVES, atol=1e-3):
    assert len(found) == len(wanted)
    for one, points in zip(found.values(), wanted, strict=True):
        np.testing.assert_allclose(one.points.values, points, atol=atol)


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


def test_a_european_table_a_workbook_and_many_markups(tmp_path):
    import_cases.write_european_csv(tmp_path / "six.csv", CURVES)
    found = curves_of(tmp_path / "six.csv")
    assert list(found) == ["Nadel_1", "Nadel_2", "Nadel_3"]
    assert {one.unit for one in found.values()} == {"mm"}
    assert_same(found)
    assert found["Nadel_2"].points.lines[0] == 5
    import_cases.write_workbook(tmp_path / "six.xlsx", CURVES)
    found = curves_of(tmp_path / "six.xlsx")
    assert list(found) == ["Nadel_1", "Nadel_2", "Nadel_3"]
    assert_same(found)
    folder = tmp_path / "markups"
    folder.mkdir()
    for n, curve in enumerate(CURVES):
        import_cases.write_markups(folder / f"{n}.mrk.json", "C", curve, system="RAS" if n else "LPS")
    (folder / "readme.txt").write_text("nothing here")
    content = read_content([folder])
    assert [one.name for one in content.curves] == ["C", "C-2", "C-3"] and len(content.unused) == 1
    assert_same({one.name: one for one in content.curves})


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "latin-1"])
@pytest.mark.parametrize(
    ("separator", "decimal"), [(";", ","), ("\t", "."), ("|", ","), (",", "."), (" ", ",")]
)
def test_separator_decimal_sign_and_encoding_are_found(tmp_path, encoding, separator, decimal):
    lines = [separator.join(f"{value:.3f}".replace(".", decimal) for value in row) for row in CURVES[0]]
    (tmp_path / "a.txt").write_bytes("\n".join(lines).encode(encoding))
    assert read_text_cells(tmp_path / "a.txt").decimal == decimal
    assert_same(curves_of(tmp_path / "a.txt"), CURVES[:1])


def test_a_long_table_with_names_and_attributes_or_a_column_that_names_the_curves(tmp_path):
    rows = ["needle;medium;bevel side;i;x [cm];y [cm];z [cm]"]
    for name, curve in zip("ab", CURVES, strict=False):
        rows += [f"{name};gel;-1;{n};" + ";".join(f"{v / 10:.5f}" for v in p) for n, p in enumerate(curve)]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    found = curves_of(tmp_path / "a.csv")
    assert found["a"].unit == "cm" and found["a"].attributes == {"medium": "gel", "bevel_side": "-1"}
    assert_same(found, [curve / 10 for curve in CURVES[:2]])
    rows = [f"{n};{i};{x};{y};{z}" for n, one in enumerate(CURVES[:2]) for i, (x, y, z) in enumerate(one)]
    (tmp_path / "a.csv").write_text("\n".join(["Serie;t;x;y;z", *rows]))
    found = curves_of(tmp_path / "a.csv")
    assert_same(found, CURVES[:2])
    assert set(found) == {"0", "1"} and found["0"].remarks[1][:2] == ("curves", "one for each Serie")


@pytest.mark.parametrize("title", ["", "needle {}\n", "x y z\n"])
def test_curves_below_each_other(tmp_path, title):
    parts = [title.format(n) + "\n".join(" ".join(map(str, p)) for p in one) for n, one in enumerate(CURVES)]
    (tmp_path / "a.dat").write_text("\n\n".join(parts))
    assert_same(curves_of(tmp_path / "a.dat"))


def test_columns_by_name_number_and_without_header(tmp_path):
    rows = [",".join(map(str, [n, *p[[2, 0, 1]], 7.5, 8.5])) for n, p in enumerate(CURVES[0])]
    (tmp_path / "a.csv").write_text("\n".join(["n,c,a,b,d,e", *rows]))
    for columns in (("a", "b", "c"), ("3", "4", "2")):
        assert_same(curves_of(tmp_path / "a.csv", columns), CURVES[:1])
    for columns in ((), ("a", "b", "q")):
        refusal(DataError, "--columns", curves_of, tmp_path / "a.csv", columns)
    (tmp_path / "a.csv").write_text("\n".join(["x,y", *(f"{x},{y}" for x, y, _ in CURVES[0])]))
    assert_same(curves_of(tmp_path / "a.csv"), CURVES[:1])
    (tmp_path / "b.csv").write_text("\n".join(["R,A,S", *(f"{-x},{-y},{z}" for x, y, z in CURVES[0])]))
    found = curves_of(tmp_path / "b.csv")
    assert found["b"].system == "LPS"
    assert_same(found, CURVES[:1])


@pytest.mark.parametrize("count", ["Punkt", "No.", ""])
def test_columns_that_name_their_quantity_beside_the_axis(tmp_path, count):
    title, head = "Gel, 18 G;;", f"{count};Einstichtiefe x (cm);Auslenkung y (cm)"
    rows = [f"{n};{x / 10:.4f};{y / 10:.4f}".replace(".", ",") for n, (x, y, _) in enumerate(CURVES[0], 1)]
    (tmp_path / "one.csv").write_text("\n".join([title, head, *rows]))
    (found,) = curves_of(tmp_path / "one.csv").values()
    assert found.unit == "cm"
    np.testing.assert_allclose(10 * found.points.values[:, :2], CURVES[0][:, :2], atol=1e-3)
    assert not found.points.values[:, 2].any()


@pytest.mark.parametrize(
    "variables",
    [
        {"runs": {"a": CURVES[0], "b": CURVES[1], "c": CURVES[2].T}},
        {"c": np.array([{k: one[:, n] for n, k in enumerate("xyz")} for one in CURVES], dtype=object)},
        {"rows": np.vstack([[[4 + n, m, *p] for m, p in enumerate(one)] for n, one in enumerate(CURVES)])},
        {"rows": np.vstack([[[*p, n] for p in one] for n, one in enumerate(CURVES)])},
    ],
)
def test_matlab_structs_and_cells(tmp_path, variables):
    savemat(tmp_path / "a.mat", variables)
    assert_same(curves_of(tmp_path / "a.mat"))


@pytest.mark.parametrize("per_number", [1, 10])
def test_a_first_column_that_only_counts_is_doubted(tmp_path, per_number):
    numbers = 1.0 + np.arange(30) // per_number
    points = np.column_stack([numbers, np.arange(30) % 10 * 4.0, np.arange(30) ** 2 / 300])
    savemat(tmp_path / "a.mat", {"runs": points})
    assert understood([tmp_path], units="mm")[1]["x"][1] == "assumption"
    savemat(tmp_path / "a.mat", {"runs": points - [1.0, 0.0, 0.0]})  # millimetres from the entry
    assert "x" not in understood([tmp_path], units="mm")[1]


@pytest.mark.parametrize("head", ["{0},{1} mm,", "N{0},{1},", "{1} [mm];", ""])
def test_coordinates_in_rows(tmp_path, head):
    """The rows of a needle may be labelled; without any labels the table holds a single one."""
    curves = CURVES if "{0}" in head else CURVES[:1]
    separator = ";" if ";" in head else ","
    rows = [
        head.format(n, axis) + separator.join(f"{value:.4f}" for value in values)
        for n, one in enumerate(curves, 1)
        for axis, values in zip("xyz", one.T, strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    assert_same(curves_of(tmp_path / "a.csv"), curves)
    rows[1] = rows[1].replace("0", "?")
    (tmp_path / "a.csv").write_text("\n".join(rows))
    if head:
        assert "column" in refusal(DataError, "", read_content, [tmp_path / "a.csv"]).where


@pytest.mark.parametrize("head", ["Nr;Punkt;x;y;z", ""])
def test_numbers_of_curves_and_points(tmp_path, head):
    rows = [[n, m, *p] for n, one in enumerate(CURVES, 1) for m, p in enumerate(one)]
    lines = [head, *(";".join(map(str, row)) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert_same(curves_of(tmp_path / "a.csv"))


def test_deviations_of_points_are_read_in_their_unit(tmp_path):
    rows = [[n, *(p / 10), 0.2 + n] for n, one in enumerate(CURVES, 1) for p in one]
    lines = ["id;x [cm];y [cm];z [cm];sd [mm]", *(";".join(map(str, row)) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    found = [one.points.sd for one in understood([tmp_path])[0].insertions]
    for n, sd in enumerate(found, 1):
        np.testing.assert_allclose(sd, 0.2 + n)
    (tmp_path / "a.csv").write_text("\n".join([*lines[:9], "", *lines[9:]]))
    assert [len(one.points.sd) for one in understood([tmp_path])[0].insertions] == [*map(len, CURVES)]
    (tmp_path / "a.csv").write_text(
        "\n".join([*lines[:8], "", *(line.rpartition(";")[0] for line in lines[8:])])
    )
    plan, made = understood([tmp_path])
    assert plan.insertions[0].points.sd is None and "not used" in made


SIDES = {"N1": "1", "N2": "-1", "N3": "1"}
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
    "blocks": {"text 'Protocol, by me'"},
    "side by side": set(),
    "a sheet of needles": {"column Datum"},
    "a target in every row": {f"column Target (mm) {axis}" for axis in "xyz"},
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_of_sheets_lose_nothing(tmp_path, layout):
    file = write_sheets(tmp_path / "a.xlsx", **LAYOUTS[layout])
    content = read_content([file])
    found = {one.name: one for one in content.curves}
    assert list(found) == list(SIDES)
    assert_same(found)
    assert {what for what, _ in content.unused} == LEFT_OUT[layout]
    plan, made = understood([file], pose="1,0,0", bevel="0,1,0")
    assert [one.row.side for one in plan.insertions] == [1, -1, 1]
    assert made["bevel side"][1] == "file" and made["units"] == ("mm", "file")


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
    assert {name: one.attributes["bevel_side"] for name, one in found.items()} == SIDES
    forces = {f"variable needles_{n}_force" for n in (1, 2, 3)}
    assert {what for what, _ in content.unused} == {"field rate", *forces}


def test_lists_beside_a_list_of_curves_and_structs_beside_a_curve_state_one_of_each(tmp_path):
    cells, ids = np.empty(3, dtype=object), np.array(list(SIDES), dtype=object)
    cells[:] = CURVES
    savemat(tmp_path / "a.mat", {"lines": cells, "bevel": [1.0, -1.0, 1.0], "ids": ids})
    found = curves_of(tmp_path / "a.mat")
    assert {name: one.attributes["bevel_side"] for name, one in found.items()} == SIDES
    runs = {f"r{n}": {"xyz": one, "about": {"bevel": "left", "by": "me"}} for n, one in enumerate(CURVES)}
    savemat(tmp_path / "a.mat", {"runs": runs})
    content = read_content([tmp_path / "a.mat"])
    assert [one.attributes for one in content.curves] == [{"bevel_side": "left"}] * 3
    assert [what for what, _ in content.unused] == ["field by"]


def test_names_that_come_again_in_another_specimen_are_other_curves(tmp_path):
    rows = [["Probe", "Nadel", "Schliff", *"xyz"]]
    rows += [[1 + n // 2, 1 + n % 2, 1 - 2 * (n % 2), *point] for n in range(3) for point in CURVES[n]]
    file = write_sheets(tmp_path / "a.xlsx", a=rows)
    found = curves_of(file)
    assert_same(found)
    stated = [(name, one.attributes["specimen"], one.attributes["bevel_side"]) for name, one in found.items()]
    assert stated == [("1-1", "1", "1"), ("1-2", "1", "-1"), ("2-1", "2", "1")]


def test_needles_joined_in_one_table_are_divided(tmp_path):
    rows = ["x,y,z", *(",".join(map(str, point)) for point in point_rows())]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    assert_same(curves_of(tmp_path / "a.csv"))
    _, made = understood([tmp_path / "a.csv"])
    assert made["points of a.csv"] == ("3 curves", "guess")


@pytest.mark.sweep
@pytest.mark.parametrize("transform", ["tfm", "h5", "inline"])
def test_a_scene_with_its_transform(tmp_path, transform):
    scene = import_cases.write_scene(tmp_path / "s", CURVES, transform)
    for path in (scene, import_cases.write_bundle(tmp_path / "s.mrb", tmp_path / "s")):
        content = read_content([path])
        assert [one.name for one in content.curves] == ["Needle_1", "Needle_2", "Needle_3"]
        assert_same({one.name: one for one in content.curves}, atol=1e-9)
        (model,) = content.surfaces
        assert model.surface.name == "fat" and model.path == (path if path.suffix == ".mrb" else model.path)
        np.testing.assert_allclose(model.surface.mesh.vertices[:, 0], 20.0)


def test_transforms_are_chained_from_the_inside_out(tmp_path):
    import_cases.write_scene(tmp_path / "s", CURVES[:1], "tfm")
    shift = "1 0 0 100  0 1 0 0  0 0 1 0  0 0 0 1"  # RAS: 100 mm to the right
    scene = tmp_path / "s" / "scene.mrml"
    text = scene.read_text().replace('references="storage:ts;"', 'references="storage:ts;transform:u"')
    node = f' <Transform id="u" name="U" matrixTransformToParent="{shift}"></Transform>\n</MRML>'
    scene.write_text(text.replace("</MRML>", node))
    (one,) = read_content([scene]).curves
    np.testing.assert_allclose(one.points.values, CURVES[0] - [100, 0, 0], atol=1e-9)
    assert np.linalg.det(import_cases.TURN) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "data",
    [
        import_cases.vtk_sheet(20.0),
        import_cases.vtk_sheet(-20.0, system="RAS"),
        import_cases.vtk_binary_sheet(-20.0),
    ],
)
def test_vtk_surfaces(tmp_path, data):
    (tmp_path / "a.vtk").write_bytes(data)
    mesh = read_surface(tmp_path / "a.vtk", "sheet", 2).mesh
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_allclose(mesh.vertices[:, 0], 20.0)


# ---- hostile files


def test_a_bundle_that_names_files_outside_or_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    import_cases.write_scene(tmp_path / "s", CURVES[:1])
    for member in ("../x.mrml", "/etc/x.stl", "a/../../x.stl", "C:\\x.stl", "a\\..\\..\\x.stl"):
        import_cases.write_bundle(tmp_path / "a.mrb", tmp_path / "s", [(member, b"x")])
        refusal(DataError, "outside", read_content, [tmp_path / "a.mrb"])
    assert not (tmp_path / "x.mrml").exists()
    monkeypatch.setattr(files, "MAX_UNPACKED_BYTES", 2**20)
    import_cases.write_bundle(tmp_path / "a.mrb", tmp_path / "s", [("case/big.stl", b"\0" * 2**22)])
    refusal(DataError, "unpacks", read_content, [tmp_path / "a.mrb"])


BOMB = '<!DOCTYPE MRML [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>\n<MRML name="&b;"></MRML>'
OUTSIDE = [
    ("MarkupsCurve", {"id": "c", "name": "C", "references": "storage:s;"}),
    ("MarkupsJsonStorage", {"id": "s", "fileName": "../secret.mrk.json"}),
]
LOOP = [
    ("MarkupsCurve", {"id": "c", "name": "C", "references": "storage:s;transform:t"}),
    ("MarkupsJsonStorage", {"id": "s", "fileName": "c.mrk.json"}),
    ("Transform", {"id": "t", "references": "transform:t"}),
]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        *((BOMB, "entities"), ("<MRML><a></MRML>", "XML"), ("<html></html>", "no scene"), ("", "XML")),
        *((import_cases.scene_text(OUTSIDE), "outside"), (import_cases.scene_text(LOOP), "loop")),
        *((import_cases.scene_text(OUTSIDE).replace("../secret", "/etc/secret"), "outside"),),
        *((import_cases.scene_text(LOOP).replace("transform:t", "transform:q"), "not in the scene"),),
    ],
)
def test_a_hostile_scene_is_refused(tmp_path, text, reason):
    folder = tmp_path / "s"
    folder.mkdir()
    import_cases.write_markups(tmp_path / "secret.mrk.json", "C", CURVES[0])
    import_cases.write_markups(folder / "c.mrk.json", "C", CURVES[0])
    (folder / "scene.mrml").write_text(text)
    refusal(DataError, reason, read_content, [folder / "scene.mrml"])


@pytest.mark.parametrize("kind", ["BSplineTransform_double_3_3", "AffineTransform_double_2_2"])
def test_a_transform_that_is_not_linear_is_refused(tmp_path, kind):
    import_cases.write_scene(tmp_path / "s", CURVES[:1])
    file = tmp_path / "s" / "Data" / "Tisch neu.tfm"
    file.write_text(file.read_text().replace("AffineTransform_double_3_3", kind))
    refusal(DataError, "harden", read_content, [tmp_path / "s" / "scene.mrml"])


@pytest.mark.sweep
def test_a_workbook_that_unpacks_to_gigabytes_or_is_huge_is_refused(tmp_path):
    from openpyxl import Workbook

    with zipfile.ZipFile(tmp_path / "bomb.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        for n in range(9):
            archive.writestr(f"xl/{n}.xml", b"\0" * 2**26)
    book = Workbook()
    book.active.cell(900_000, 3, 1.0)
    book.active.cell(1, 1, 1.0)
    book.save(tmp_path / "huge.xlsx")
    (tmp_path / "none.xlsx").write_bytes(b"PK\x03\x04 no archive")
    (tmp_path / "text.xls").write_text("x;y;z")
    for name in ("bomb.xlsx", "huge.xlsx", "none.xlsx", "text.xls"):
        refusal(DataError, "CSV", read_sheets, tmp_path / name)


# ---- what imported files are taken to mean, what is written, and how bad input ends

NEEDLES = [import_cases.needle(n, 16) for n in range(3)]


def understood(paths, **options):
    """Return the plan, and the decisions by name: (value, source)."""
    decisions = Decisions({key.replace("_", " "): value for key, value in options.items()})
    _, plan = plan_import(paths, decisions)
    return plan, {one.what: (one.value, one.source) for one in decisions.made}


def write_plain(folder, curves, name="points.csv", scale=1.0):
    parts = ["\n".join(",".join(f"{scale * v:.8g}" for v in p) for p in one) for one in curves]
    (folder / name).write_text("\n\n".join(parts))
    return folder / name


def with_shaft(curve):
    """Return a needle that begins 18 mm before its entry."""
    x = np.linspace(-18.0, -3.0, 6)
    return np.vstack([np.column_stack([x, np.full((6, 2), curve[0, 1:])]), curve])


def test_units_are_guessed_by_the_longest_needle_and_asked_where_they_are_not_clear(tmp_path):
    for scale, unit in [(1.0, "mm"), (1e-3, "m"), (1e3, "um")]:
        plan, made = understood([write_plain(tmp_path, NEEDLES, scale=scale)])
        assert made["units"] == (unit, "guess")
        assert plan.insertions[0].row.depth == pytest.approx(60.02, abs=0.1)
    file = write_plain(tmp_path, NEEDLES, scale=0.1)
    refusal(ConfigError, "--units", understood, [file])
    plan, made = understood([file], units="cm")
    assert made["units"] == ("cm", "option")
    assert plan.insertions[0].row.depth == pytest.approx(60.02, abs=0.1)


def test_the_end_that_scatters_least_is_the_entry(tmp_path):
    plan, made = understood([write_plain(tmp_path, [one[::-1] for one in NEEDLES])])
    assert made["entry"] == ("last", "guess")
    np.testing.assert_allclose(plan.insertions[1].points.values, NEEDLES[1], atol=1e-6)
    assert understood([write_plain(tmp_path, NEEDLES[:1])])[1]["entry"] == ("first", "assumption")


def write_layers(folder, sign=1.0):
    for x in (20.0, 35.0):
        sheet = make_sheet(f"b{x:g}", (sign * x, 0.0, 0.0), (1.0, 0.0, 0.0), 80.0, 2)
        write_surface(sheet, folder / f"b{x:g}.stl")


def test_ras_and_lps_are_tried_against_the_surfaces(tmp_path):
    write_layers(tmp_path, -1.0)
    import_cases.write_markups(tmp_path / "c.mrk.json", "c", NEEDLES[0])
    plan, made = understood([tmp_path])
    assert made["surfaces frame"] == ("RAS", "guess") and made["frame"] == ("LPS", "file")
    assert plan.insertions[0].row.layers == 3
    assert [one.into for one in plan.layers.surfaces] == [2, 3]
    assert understood([tmp_path], surfaces_frame="LPS")[0].insertions[0].row.layers == 1
    (tmp_path := tmp_path / "b").mkdir()
    (tmp_path / "fat.vtk").write_bytes(import_cases.vtk_sheet(-20.0, system="LPS"))
    write_plain(tmp_path, NEEDLES)
    plan, made = understood([tmp_path])
    assert made["frame"] == ("RAS", "guess")
    np.testing.assert_allclose(plan.insertions[0].points.values, NEEDLES[0] * [-1, -1, 1], atol=1e-6)


def test_a_needle_is_cut_at_the_tissue_and_its_shaft_gives_the_pose(tmp_path):
    write_surface(make_sheet("skin", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 90.0, 2), tmp_path / "skin.stl")
    write_layers(tmp_path)
    write_plain(tmp_path, [with_shaft(one) for one in NEEDLES])
    plan, made = understood([tmp_path])
    assert made["tissue surface"] == ("skin", "guess") and made["pose"] == ("shaft", "guess")
    row = plan.insertions[1].row
    np.testing.assert_allclose(row.entry, [0.0, 3.0, 0.0], atol=0.01)
    np.testing.assert_allclose(row.direction, [1.0, 0.0, 0.0], atol=1e-6)
    assert (row.pose_source, row.layers) == ("shaft", 3)
    assert len(understood([tmp_path], tissue_surface="none", pose="tangent")[0].layers.surfaces) == 3
    write_surface(make_sheet("skin", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 90.0, 2), tmp_path / "skin.stl")
    write_plain(tmp_path, [with_shaft(one) for one in NEEDLES])
    plan, made = understood([tmp_path], point_sd="0.1")
    assert made["pose angle sd"] == ("shaft", "guess") and made["entry point"] == ("first", "guess")
    x = np.linspace(-18.0, -3.0, 6)
    assert plan.insertions[0].row.pose_angle_sd == pytest.approx(0.1 / np.linalg.norm(x - x.mean()))
    plan, _ = understood([tmp_path], pose_angle_sd="1")
    assert np.degrees(plan.insertions[0].row.pose_angle_sd) == pytest.approx(1.0)


def test_the_first_solid_entered_from_outside_is_the_tissue(tmp_path):
    block = make_cylinder("block", ((0.0, 0.0, 0.0), (90.0, 0.0, 0.0)), 40.0, 2)
    write_surface(block, tmp_path / "a.stl")
    core = make_cylinder("core", ((30.0, 0.0, 0.0), (80.0, 0.0, 0.0)), 30.0, 2)
    write_surface(core, tmp_path / "b.stl")
    write_plain(tmp_path, [with_shaft(one)[::-1] for one in NEEDLES])
    plan, made = understood([tmp_path])
    assert made["entry"] == ("last", "guess") and made["tissue surface"] == ("a", "guess")
    assert [(one.name, one.kind, one.into) for one in plan.layers.surfaces] == [("b", "solid", 2)]


def test_a_stated_direction_leaves_the_entry_and_its_errors_to_be_decided(tmp_path):
    file = write_plain(tmp_path, NEEDLES)
    plan, made = understood([file], pose="1,0,0", point_sd="0.03")
    assert made["entry point"] == ("first", "assumption") and made["pose shift sd"] == ("0.03", "guess")
    assert made["pose angle sd"] == ("0.5", "assumption")
    row = plan.insertions[1].row
    np.testing.assert_allclose(row.entry, NEEDLES[1][0], atol=1e-6)
    assert (row.pose_shift_sd, np.degrees(row.pose_angle_sd)) == (0.03, pytest.approx(0.5))
    stated = {"entry_point": "0,0,0", "pose_shift_sd": "0", "pose_angle_sd": "0,2"}
    plan, made = understood([file], pose="2,0,0", **stated)
    row = plan.insertions[1].row
    np.testing.assert_array_equal(row.entry, np.zeros(3))
    assert (row.pose_shift_sd, np.degrees(row.pose_angle_sd)) == (0.0, pytest.approx(0.2))
    assert {made[name][1] for name in ("entry point", "pose shift sd", "pose angle sd")} == {"option"}
    assert understood([file], pose="1,0,0", entry_point="0,0,0")[1]["pose shift sd"] == ("0.1", "assumption")


def test_boundaries_are_stated_as_depths(tmp_path):
    file = write_plain(tmp_path, NEEDLES)
    plan, _ = understood([file], pose="1,0,0", boundaries="15,5;52,0", boundary_sd="0.3")
    assert plan.layers.depths_mm == (15.5, 52.0)
    assert [one.row.layers for one in plan.insertions] == [3, 3, 2]
    assert {one.row.boundary_sd for one in plan.insertions} == {0.3}
    assert understood([file], boundaries="15,52")[1]["boundary sd"] == ("0.5", "assumption")
    assert understood([file])[1]["boundaries"] == ("none", "guess")
    write_layers(tmp_path)
    refusal(ConfigError, "--boundaries", understood, [tmp_path], boundaries="15")


def test_boundaries_of_a_column_are_those_of_each_needle(tmp_path):
    write_plain(tmp_path, NEEDLES)
    rows = ["id;Boundary [cm];bevel"]
    (tmp_path / "info.csv").write_text("\n".join([*rows, "1;1,83;1", "2;2,1;1", "3;1,94;1"]))
    assert run("import", tmp_path, "--out", tmp_path / "gel", "--pose", "1,0,0", "--yes") == 0
    for one, depth in zip(read(tmp_path / "gel").insertions, (18.3, 21.0, 19.4), strict=True):
        assert one.boundaries == pytest.approx([depth], abs=1e-3) and one.sequence == (1, 2)
    assert understood([tmp_path], boundaries="15")[0].layers.depths_mm == (15.0,)
    assert understood([tmp_path], boundaries="none")[0].insertions[0].row.layers == 1
    (tmp_path / "info.csv").write_text("\n".join([*rows, "1;1,83;1", "2;1,83;1", "3;1,83;1"]))
    plan, made = understood([tmp_path])
    assert plan.layers.depths_mm == (18.3,) and made["boundaries"] == ("18.3", "file")
    (tmp_path / "info.csv").write_text("\n".join([*rows, "1;1,83;1", "2;2,1;1", "3;;1"]))
    refusal(ConfigError, "--boundaries", understood, [tmp_path])


def test_bevel_sides_of_a_table_need_a_direction(tmp_path):
    turned = [NEEDLES[0], NEEDLES[0] * [1, -1, 1]]
    rows = [
        f"n{n},{side},gel,block{n}," + ",".join(f"{v:.6f}" for v in p)
        for n, (side, one) in enumerate(zip((1, -1), turned, strict=True))
        for p in one
    ]
    (tmp_path / "a.csv").write_text("\n".join(["id,bevel side,medium,specimen,x,y,z", *rows]))
    plan, made = understood([tmp_path / "a.csv"], pose="1,0,0")
    assert made["bevel"] == ("0,1,0", "guess") and made["bevel side"] == ("1=1, -1=-1", "file")
    assert [one.row.side for one in plan.insertions] == [1, -1]
    refusal(ConfigError, "--bevel", understood, [tmp_path / "a.csv"], pose="1,0,0", bevel_side="1,-1")
    refusal(ConfigError, "--bevel", understood, [tmp_path / "a.csv"], pose="1,0,0", bevel="bend")
    out = tmp_path / "gel"
    assert (
        run("import", tmp_path / "a.csv", "--out", out, "--pose", "1,0,0", "--bevel", "0,1,0", "--yes") == 0
    )
    dataset = read(out)
    assert [one.side for one in dataset.insertions] == [1, -1]
    assert [one.specimen for one in dataset.insertions] == ["block0", "block1"]
    assert [one.deflection for one in dataset.insertions] == pytest.approx([1.44, 1.44])
    decided = {one["what"]: one for one in read_toml(out / "dataset.toml")["import"]["decisions"]}
    assert decided["medium"]["source"] == decided["specimen"]["source"] == "file"


@pytest.mark.parametrize(
    ("texts", "sides", "source"),
    [
        (["left", "right", "left"], [-1, 1, -1], "file"),
        (["rechts", "links", "rechts"], [1, -1, 1], "file"),
        (["90 deg", "270", "90"], [1, -1, 1], "file"),
        (["0", "1", "1"], [-1, 1, 1], "assumption"),
        (["A", "B", "A"], [1, -1, 1], "assumption"),
        (["1", "", "-1"], [1, 1, -1], "assumption"),
        (["", "", ""], [1, 1, 1], "assumption"),
    ],
)
def test_sides_are_read_or_stand_as_an_assumption(tmp_path, texts, sides, source):
    rows = [["id", "Schliff", *"xyz"], *point_rows(lambda name, _: [name, texts[list(SIDES).index(name)]])]
    file = write_sheets(tmp_path / "a.xlsx", a=rows)
    plan, made = understood([file], pose="1,0,0", bevel="0,1,0", units="mm")
    assert [one.row.side for one in plan.insertions] == sides and made["bevel side"][1] == source
    plan, made = understood([file], pose="1,0,0", bevel="0,1,0", units="mm", bevel_side="N1=1,N2=-1,N3=-1")
    assert [one.row.side for one in plan.insertions] == [1, -1, -1] and made["bevel side"][1] == "option"
    assert understood([file], units="mm")[1]["bevel"] == ("bend", "guess" if any(texts) else "assumption")


@pytest.mark.parametrize(
    "names",
    [
        ("a (Schliff oben)", "b (Schliff unten)", "c (Schliff oben)"),
        ("a_bevel+1", "b_bevel-1", "c_bevel+1"),
        ("gel_01_+1", "gel_02_-1", "gel_03_+1"),
    ],
)
def test_a_side_may_stand_in_the_names_of_curves(tmp_path, names):
    for name, curve in zip(names, CURVES, strict=True):
        write_plain(tmp_path, [curve], f"{name}.csv")
    plan, made = understood([tmp_path], pose="1,0,0", bevel="0,1,0")
    assert [one.row.side for one in plan.insertions] == [1, -1, 1] and made["bevel side"][1] == "file"


@pytest.mark.parametrize(
    "names", [("gel_1", "gel_2", "gel_3"), ("gel-1", "gel-2", "gel-3"), ("a_-1", "b", "c")]
)
def test_numbers_of_needles_are_no_sides(tmp_path, names):
    for name, curve in zip(names, CURVES, strict=True):
        write_plain(tmp_path, [curve], f"{name}.csv")
    assert understood([tmp_path], pose="1,0,0", bevel="0,1,0")[1]["bevel side"][1] == "assumption"


def test_bevels_at_right_angles_turn_the_direction_of_their_side(tmp_path):
    rows = [["id", "bevel", *"xyz"], *point_rows(lambda name, _: [name, 90 * list(SIDES).index(name)])]
    file = write_sheets(tmp_path / "a.xlsx", a=rows)
    plan, made = understood([file], pose="1,0,0", bevel="0,1,0", units="mm")
    bevels = [one.row.bevel for one in plan.insertions]
    np.testing.assert_allclose(bevels, [[0, 1, 0], [0, 0, 1], [0, -1, 0]], atol=1e-9)
    assert {one.row.side for one in plan.insertions} == {1} and made["bevel angles"][1] == "assumption"


def test_one_curve_stored_tip_first_is_turned_and_depths_are_compared(tmp_path):
    rows = [["id", "depth", *"xyz"]]
    rows += [[name, 60 - 5 * n, *p] for n, name in enumerate(SIDES) for p in CURVES[n][:: 1 if n else -1]]
    file = write_sheets(tmp_path / "a.xlsx", a=rows)
    plan, made = understood([file], units="mm")
    assert made["order of N1"] == ("turned", "assumption") and made["entry"] == ("first", "guess")
    assert made["depth"][1] == "file"
    np.testing.assert_allclose(plan.insertions[0].points.values, CURVES[0], atol=1e-9)
    rows[-1][1] = rows[1][1] = 60
    rows = [[row[0], 70 if n else row[1], *row[2:]] for n, row in enumerate(rows)]
    assert understood([write_sheets(file, a=rows)], units="mm")[1]["depth"][1] == "assumption"


def test_assumptions_that_a_verdict_depends_on_are_those_of_the_dataset(tmp_path):
    options = ["--pose", "1,0,0", "--bevel", "0,1,0", "--specimen", "each", "--point-sd", "0.05", "--yes"]
    file, out = write_plain(tmp_path, NEEDLES), tmp_path / "gel"
    assert run("import", file, "--out", out, *options) == 0
    dataset = read(out)
    assert dataset.assumed == ("bevel side = 1", "pose angle sd = 0.5", "entry point = first")
    assert describe_dataset(dataset)["assumed"] == list(dataset.assumed)
    scene = load(out / "scene.toml", SceneRecord)
    assert (scene.depth_mm, len(scene.layers)) == (pytest.approx(60.02, abs=0.1), 1)
    assert scene.needle == load(out / "dataset.toml", DatasetRecord).needle


def test_the_workbook_to_fill_in_is_read(tmp_path):
    file = tmp_path / "own.xlsx"
    assert run("new", "workbook", file) == 0
    assert run("new", "workbook", file) == 3
    content = read_content([file])
    assert [one.name for one in content.curves] == [f"n{n}" for n in range(1, 9)]
    assert {key for one in content.curves for key in one.attributes} == {
        "bevel_side",
        "depth",
        "specimen",
        "medium",
    }
    assert content.unused == ()
    _, made = understood([file], point_sd="0.2", surfaces_frame="RAS")
    assert (made["point sd"], made["pose angle sd"]) == (("0.2", "option"), ("0.1", "file"))
    assert "assumption" not in {source for _, source in made.values()}
    assert made["not used"] == ("surfaces frame = RAS", "option")


def test_a_sheet_states_answers_in_their_unit_and_an_empty_cell_is_an_assumption(tmp_path):
    rows = [["name", "value", "unit"], ["Point SD", "0,05", "mm"], ["pose", None], ["Stage", "new"]]
    sheets = {"a": [["id", *"xyz"], *point_rows(lambda name, _: [name])], "Example points": [[*"xyz"]]}
    plan, made = understood([write_sheets(tmp_path / "a.xlsx", setup=rows, **sheets)], units="mm")
    assert plan.point_sd_mm == 0.05 and made["pose"] == ("free", "assumption")
    assert made["not used"] == ("row Stage = new", "file")
    write_sheets(tmp_path / "b.xlsx", setup=[["point sd", 0.1]], **sheets)
    refusal(DataError, "another file", read_content, [tmp_path])
    write_sheets(tmp_path / "b.xlsx", setup=[["point sd", 0.1, "cm"]], **sheets)
    refusal(DataError, "cm", read_content, [tmp_path / "b.xlsx"])


@pytest.mark.parametrize("answer", ["y", "n"])
def test_in_a_terminal_the_picture_comes_before_the_questions_and_writing(tmp_path, monkeypatch, answer):
    asked, out = [], tmp_path / "gel"

    def prompt(text, default, **_):
        asked.append((text, out.exists()))
        return default

    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setattr("typer.prompt", prompt)
    monkeypatch.setattr("typer.confirm", lambda *_, **__: answer == "y")
    drawn = []
    monkeypatch.setattr("needlefit.reporting.dataset_import.draw", lambda path, _: drawn.append(len(asked)))
    assert run("import", write_plain(tmp_path, NEEDLES), "--out", out) == 0
    assert len(asked) > 5 and not any(exists for _, exists in asked)
    assert drawn[0] == 0 and out.exists() == (answer == "y")
    if out.exists():
        assert "bevel = bend" in read(out).assumed


INFO = [["Insertion", "Needle", "Bevel", "Depth (mm)", "Date"]]


def sheets_of_needles(needles, points=()):
    """Return an information sheet and a sheet of points for each needle; `points` replace those of some."""
    info = [
        [f"Ins{n}", text, "up" if n % 2 else "down", 60 - 5 * n, "today"] for n, text in enumerate(needles)
    ]
    sheets = {f"Ins{n}": [["X (mm)", "Y (mm)", "Z (mm)"], *CURVES[n].tolist()] for n in range(len(needles))}
    return {"Info": INFO + info, **sheets, **dict(points)}


@pytest.mark.parametrize(
    ("needle", "taken", "unused"),
    [
        ("22G nitinol", ("22G", "nitinol"), {"column Date"}),
        ("Cook, 18 gauge x 150 mm (stainless steel)", ("18G", "steel"), {"column Date"}),
        ("1,27 mm", ("1.27", None), {"column Date"}),
        ("type A", (None, None), {"column Date", "column Needle"}),
    ],
)
def test_a_column_describes_the_needle_or_is_named_as_not_used(tmp_path, needle, taken, unused):
    file = write_sheets(tmp_path / "a.xlsx", **sheets_of_needles([needle] * 3))
    assert {what for what, _ in read_content([file]).unused} == unused
    _, made = understood([file])
    for what, value, default in zip(("diameter", "modulus"), taken, ("18G", "steel"), strict=True):
        assert made[what] == ((value, "file") if value else (default, "assumption"))
    if "150 mm" in needle:
        assert made["needle length"] == ("150", "file")


def test_several_needles_are_no_dataset_and_a_needle_that_is_not_stated_is_an_assumption(tmp_path):
    file = write_sheets(tmp_path / "a.xlsx", **sheets_of_needles(["18G", "22G", "18G"]))
    assert "Ins1" in refusal(ConfigError, "--diameter", understood, [file]).what
    assert understood([file], diameter="20G")[0].needle.outer_diameter_mm == 0.908
    file = write_sheets(tmp_path / "a.xlsx", **sheets_of_needles(["22G", "22G", None]))
    assert understood([file])[1]["diameter"] == ("22G", "assumption")


def test_a_bad_cell_of_a_sheet_stops_the_import_at_its_cell(tmp_path):
    head = [["X (mm)", "Y (mm)", "Z (mm)"]]
    bad = [[None, *row] for row in head + CURVES[1].tolist()]
    bad[2][2] = None
    points = {"Ins1": [[], *bad], "Ins2": [*head, ["#REF!", 1.0, 2.0], *CURVES[2].tolist()], "Ins3": []}
    file = write_sheets(tmp_path / "a.xlsx", **sheets_of_needles(["22G"] * 3, points))
    error = refusal(DataError, "2 faults", read_content, [file])
    assert "sheet 'Ins1', cell C4" in str(error) and "sheet 'Ins2', cell A2" in str(error)
    file = write_sheets(tmp_path / "a.xlsx", **sheets_of_needles(["22G"] * 3, {"Ins3": []}))
    assert ("sheet Ins3", "it is empty") in read_content([file]).unused


def test_a_needle_that_is_listed_twice_is_named_with_its_rows(tmp_path):
    import_cases.write_european_csv(tmp_path / "points.csv", CURVES)
    rows = ["Nadel;Tiefe", *(f"Nadel {n};60" for n in (1, 2, 3, 2)), ";9"]
    (tmp_path / "info.csv").write_text("\n".join(rows))
    error = refusal(DataError, "'Nadel 2' is listed 2 times, in rows 3 and 5", read_content, [tmp_path])
    assert error.where == f"{tmp_path / 'info.csv'}:5"
    (tmp_path / "info.csv").write_text("\n".join(rows[:4] + rows[5:]))
    assert "row 9" in {what for what, _ in read_content([tmp_path]).unused}
    (tmp_path / "more.csv").write_text("Nadel;Schliff;Tiefe\nNadel 1;-1;60")
    assert read_content([tmp_path]).curves[0].attributes == {"depth": "60", "bevel_side": "-1"}
    (tmp_path / "more.csv").write_text("Nadel;Schliff;Tiefe\nNadel 1;-1;61")
    refusal(DataError, "'61' as depth of needle 'Nadel 1'", read_content, [tmp_path])


def test_subfolders_are_named(tmp_path):
    (tmp_path / "a").mkdir()
    assert "folder a" in refusal(DataError, "", read_content, [tmp_path]).what
    write_plain(tmp_path, NEEDLES)
    assert [what for what, _ in read_content([tmp_path]).unused] == ["folder a"]


def test_a_stated_unit_that_no_needle_has_is_refused_and_an_option_corrects_it(tmp_path):
    rows = [f"{n},{x},{y},{z}" for n, one in enumerate(NEEDLES) for x, y, z in one]
    (tmp_path / "a.csv").write_text("\n".join(["id,X_m,Y_m,Z_m", *rows]))
    assert "60 m" in refusal(DataError, "--units", understood, [tmp_path]).what
    plan, made = understood([tmp_path], units="mm")
    assert made["units"] == ("mm", "option") and plan.insertions[0].row.depth == pytest.approx(60.02, abs=0.1)


def test_a_depth_without_unit_may_have_that_of_the_points(tmp_path):
    array = np.empty(3, dtype=[(name, object) for name in ("name", "points", "depth")])
    array[:] = [(f"n{n}", one / 1e3, one[-1, 0] / 1e3) for n, one in enumerate(NEEDLES)]
    savemat(tmp_path / "a.mat", {"trials": array})
    assert understood([tmp_path])[1]["depth"] == ("lengths of the curves", "file")


def test_a_specimen_that_is_not_stated_of_one_needle_is_named(tmp_path):
    blocks = dict(zip(SIDES, ("A", "A", None), strict=True))
    rows = [
        ["id", "specimen", "x [mm]", "y [mm]", "z [mm]"],
        *point_rows(lambda name, _: [name, blocks[name]]),
    ]
    decisions = Decisions()
    _, plan = plan_import([write_sheets(tmp_path / "a.xlsx", a=rows)], decisions)
    assert [one.row.specimen for one in plan.insertions] == ["A", "A", "N3"]
    assert next(one.reason for one in decisions.made if one.what == "specimen").endswith(
        "N3: taken as its own"
    )


@pytest.mark.parametrize(("angle", "bevel"), [(0.0, [0, 1, 0]), (4.0, [0, 1, 0]), (30.0, None)])
def test_a_bevel_direction_is_an_axis_within_its_error(tmp_path, angle, bevel):
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turned = [
        one @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) for one in (NEEDLES[0], NEEDLES[0] * [1, -1, 1])
    ]
    rows = [f"{n},{1 - 2 * n},{x},{y},{z}" for n, one in enumerate(turned) for x, y, z in one]
    (tmp_path / "a.csv").write_text("\n".join(["id,bevel,x [mm],y [mm],z [mm]", *rows]))
    decisions = Decisions({"pose": "1,0,0", "point sd": "0.1"})
    _, plan = plan_import([tmp_path], decisions)
    np.testing.assert_allclose(plan.insertions[0].row.bevel, bevel or [0, c, s], atol=1e-3)
    # 0.1 mm at the entry and the tip of two needles that deflect by 1.44 mm
    sd = np.degrees(0.1 / 1.44)
    reason = next(one.reason for one in decisions.made if one.what == "bevel")
    assert f"standard deviation {sd:.2g} degrees" in reason


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        *(({"pose": "1,2"}, "--pose"), ({"entry": "middle"}, "--entry"), ({"modulus": "wood"}, "--modulus")),
        *(({"diameter": "99G"}, "--diameter"), ({"inner_diameter": "2"}, "--inner-diameter")),
        *(({"boundaries": "30,15"}, "--boundaries"), ({"boundaries": "deep"}, "--boundaries")),
        ({"pose": "1,0,0", "pose_angle_sd": "-1"}, "--pose-angle-sd"),
        ({"pose": "1,0,0", "entry_point": "last"}, "--entry-point"),
    ],
)
def test_options_that_mean_nothing_are_refused(tmp_path, options, reason):
    error = refusal(ConfigError, "", lambda: understood([write_plain(tmp_path, NEEDLES)], **options))
    assert reason in error.fix


def test_questions_are_asked_with_the_guess_and_faults_named_at_their_place(tmp_path):
    asked = {}

    def prompt(question, guess, reason):
        asked[question.what] = guess
        return {"modulus": "nitinol", "medium": "gel"}.get(question.what, "")

    decisions = Decisions({"diameter": "20G"}, prompt)
    _, plan = plan_import([write_plain(tmp_path, NEEDLES)], decisions)
    assert asked["modulus"] == "steel" and "diameter" not in asked
    assert plan.needle.youngs_modulus_gpa == 60.0 and plan.needle.outer_diameter_mm == 0.908
    sources = {one.what: one.source for one in decisions.made}
    assert (sources["medium"], sources["point sd"]) == ("answer", "confirmed")
    folded = NEEDLES[0].copy()
    folded[[6, 9]] = folded[[9, 6]]
    file = write_plain(tmp_path, [folded])
    decisions = Decisions()
    content, plan = plan_import([file], decisions)
    (tmp_path / "made").mkdir()
    error = refusal(DataError, "", write_plan, tmp_path / "made", content, plan, decisions)
    assert error.where == f"{file}:8"


def run(*words):
    ending = refusal(SystemExit, "", lambda: main([str(word) for word in words]))
    return ending.code


@pytest.mark.sweep
def test_the_command_writes_a_dataset_that_check_passes(tmp_path, capsys):
    import_cases.write_european_csv(tmp_path / "six.csv", NEEDLES)
    assert run("import", tmp_path / "six.csv", "--out", tmp_path / "gel", "--modulus", "steel", "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert [one["insertion"] for one in shown["insertions"]] == ["Nadel_1", "Nadel_2", "Nadel_3"]
    faults, warnings = check_all(tmp_path / "gel")
    assert faults == [] and {one.kind for one in warnings} == {"placeholder", "assumed"}
    assert (tmp_path / "gel" / "import.png").stat().st_size > 10_000
    load_study(tmp_path / "gel" / "gel_study.toml")
    stored = read_toml(tmp_path / "gel" / "dataset.toml")["import"]
    assert stored["decisions"] == shown["decisions"] and list(stored["files"]) == ["six.csv"]
    assert run("import", tmp_path / "six.csv", "--out", tmp_path / "again", "--modulus", "steel") == 0
    one, other = (sorted((tmp_path / name).rglob("*.[cp]*")) for name in ("gel", "again"))
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]


def test_commands_write_studies_and_datasets_of_slicer(tmp_path, capsys):
    file, out = write_plain(tmp_path, NEEDLES), tmp_path / "gel"
    assert run("import", file, "--out", out, "--specimen", "block", "--yes") == 0
    study = load_study(out / "gel_study.toml")
    assert (study.leave_out, study.same_specimen) == ("insertion", True)
    warned = []
    for words in (("check", out / "gel_study.toml"), ("check", out)):
        capsys.readouterr()
        assert run(*words) == 0
        warned.append(capsys.readouterr().err.count("warning"))
    assert warned == [1, 2]  # what stays open in a dataset is listed by its own check alone
    (tmp_path := tmp_path / "b").mkdir()
    import_cases.write_scene(tmp_path / "s", NEEDLES, "tfm")
    import_cases.write_bundle(tmp_path / "s.mrb", tmp_path / "s")
    assert run("import", tmp_path / "s.mrb", "--out", tmp_path / "gel", "--bevel", "0,1,0", "--yes") == 0
    dataset = read(tmp_path / "gel")
    assert dataset.pose == "known" and [one.sequence for one in dataset.insertions] == [(1, 2)] * 3
    assert dataset.insertions[0].boundaries[0] == pytest.approx(20.0, abs=0.01)
    assert dataset.insertions[0].planar[-1, 1] > 1.0


@pytest.mark.parametrize("text", ["", "hello\n", "1,2,3\n", "x,y,z\n1,2,3\n4,a,6\n7,8,9\n1,2,3\n", "x,x,x\n"])
def test_bad_input_ends_in_exit_code_3_and_writes_nothing(tmp_path, text, capsys):
    (tmp_path / "a.csv").write_text(text)
    assert run("import", tmp_path / "a.csv", "--out", tmp_path / "gel") == 3
    assert run("import", tmp_path / "none.xlsx", "--out", tmp_path / "gel") == 3
    assert run("import", tmp_path, "--out", tmp_path / "gel") == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv"]
    assert "a.csv" in capsys.readouterr().err
