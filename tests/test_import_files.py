"""Files of other programs are read as the curves and surfaces that they hold."""

import zipfile

import numpy as np
import pytest
from import_cases import (
    TURN,
    needle,
    scene_text,
    vtk_binary_sheet,
    vtk_sheet,
    write_bundle,
    write_european_csv,
    write_markups,
    write_scene,
    write_workbook,
)
from scipy.io import savemat

from needlefit.datasets.importing import slicer_scene
from needlefit.datasets.importing.files import read_content
from needlefit.datasets.importing.tables import parse_number, read_sheets, read_text_cells
from needlefit.errors import DataError
from needlefit.geometry.surfaces import read_surface

CURVES = [needle(n, 16 - n) for n in range(3)]


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
    write_european_csv(tmp_path / "six.csv", CURVES)
    found = curves_of(tmp_path / "six.csv")
    assert list(found) == ["Nadel_1", "Nadel_2", "Nadel_3"]
    assert {one.unit for one in found.values()} == {"mm"}
    assert_same(found)
    assert found["Nadel_2"].points.lines[0] == 5
    write_workbook(tmp_path / "six.xlsx", CURVES)
    found = curves_of(tmp_path / "six.xlsx")
    assert list(found) == ["Nadel_1", "Nadel_2", "Nadel_3"]
    assert_same(found)
    folder = tmp_path / "markups"
    folder.mkdir()
    for n, curve in enumerate(CURVES):
        write_markups(folder / f"{n}.mrk.json", "C", curve, system="RAS" if n else "LPS")
    (folder / "readme.txt").write_text("nothing here")
    content = read_content([folder])
    assert [one.name for one in content.curves] == ["C", "C-2", "C-3"] and len(content.notes) == 1
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
    (tmp_path / "a.csv").write_text("\n".join(["Stich;t;x;y;z", *rows]))
    found = curves_of(tmp_path / "a.csv")
    assert_same(found, CURVES[:2])
    assert set(found) == {"0", "1"} and found["0"].remarks[1][:2] == ("curves", "one for each stich")


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
        with pytest.raises(DataError) as error:
            curves_of(tmp_path / "a.csv", columns)
        assert "--columns" in error.value.fix
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
    ],
)
def test_matlab_structs_and_cells(tmp_path, variables):
    savemat(tmp_path / "a.mat", variables)
    assert_same(curves_of(tmp_path / "a.mat"))


@pytest.mark.sweep
@pytest.mark.parametrize("transform", ["tfm", "h5", "inline"])
def test_a_scene_with_its_transform(tmp_path, transform):
    scene = write_scene(tmp_path / "s", CURVES, transform)
    for path in (scene, write_bundle(tmp_path / "s.mrb", tmp_path / "s")):
        content = read_content([path])
        assert [one.name for one in content.curves] == ["Needle_1", "Needle_2", "Needle_3"]
        assert_same({one.name: one for one in content.curves}, atol=1e-9)
        (model,) = content.surfaces
        assert model.surface.name == "fat" and model.path == (path if path.suffix == ".mrb" else model.path)
        np.testing.assert_allclose(model.surface.mesh.vertices[:, 0], 20.0)


def test_transforms_are_chained_from_the_inside_out(tmp_path):
    write_scene(tmp_path / "s", CURVES[:1], "tfm")
    shift = "1 0 0 100  0 1 0 0  0 0 1 0  0 0 0 1"  # RAS: 100 mm to the right
    scene = tmp_path / "s" / "scene.mrml"
    text = scene.read_text().replace('references="storage:ts;"', 'references="storage:ts;transform:u"')
    node = f' <Transform id="u" name="U" matrixTransformToParent="{shift}"></Transform>\n</MRML>'
    scene.write_text(text.replace("</MRML>", node))
    (one,) = read_content([scene]).curves
    np.testing.assert_allclose(one.points.values, CURVES[0] - [100, 0, 0], atol=1e-9)
    assert np.linalg.det(TURN) == pytest.approx(1.0)


@pytest.mark.parametrize("data", [vtk_sheet(20.0), vtk_sheet(-20.0, system="RAS"), vtk_binary_sheet(-20.0)])
def test_vtk_surfaces(tmp_path, data):
    (tmp_path / "a.vtk").write_bytes(data)
    mesh = read_surface(tmp_path / "a.vtk", "sheet", 2).mesh
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_allclose(mesh.vertices[:, 0], 20.0)


# ---- hostile files


def test_a_bundle_that_names_files_outside_or_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    write_scene(tmp_path / "s", CURVES[:1])
    for member in ("../x.mrml", "/etc/x.stl", "a/../../x.stl", "C:\\x.stl", "a\\..\\..\\x.stl"):
        write_bundle(tmp_path / "a.mrb", tmp_path / "s", [(member, b"x")])
        with pytest.raises(DataError, match="outside"):
            read_content([tmp_path / "a.mrb"])
    assert not (tmp_path / "x.mrml").exists()
    monkeypatch.setattr(slicer_scene, "MAX_UNPACKED_BYTES", 2**20)
    write_bundle(tmp_path / "a.mrb", tmp_path / "s", [("case/big.stl", b"\0" * 2**22)])
    with pytest.raises(DataError, match="unpacks"):
        read_content([tmp_path / "a.mrb"])


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
        *((scene_text(OUTSIDE), "outside"), (scene_text(LOOP), "loop")),
        *((scene_text(OUTSIDE).replace("../secret", "/etc/secret"), "outside"),),
        *((scene_text(LOOP).replace("transform:t", "transform:q"), "not in the scene"),),
    ],
)
def test_a_hostile_scene_is_refused(tmp_path, text, reason):
    folder = tmp_path / "s"
    folder.mkdir()
    write_markups(tmp_path / "secret.mrk.json", "C", CURVES[0])
    write_markups(folder / "c.mrk.json", "C", CURVES[0])
    (folder / "scene.mrml").write_text(text)
    with pytest.raises(DataError, match=reason):
        read_content([folder / "scene.mrml"])


@pytest.mark.parametrize("kind", ["BSplineTransform_double_3_3", "AffineTransform_double_2_2"])
def test_a_transform_that_is_not_linear_is_refused(tmp_path, kind):
    write_scene(tmp_path / "s", CURVES[:1])
    file = tmp_path / "s" / "Data" / "Tisch neu.tfm"
    file.write_text(file.read_text().replace("AffineTransform_double_3_3", kind))
    with pytest.raises(DataError) as error:
        read_content([tmp_path / "s" / "scene.mrml"])
    assert "harden" in error.value.fix


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
        with pytest.raises(DataError) as error:
            read_sheets(tmp_path / name)
        assert "CSV" in error.value.fix
