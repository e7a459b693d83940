"""Every fault of a dataset, made in a real one: named with file, line, what was expected, how to fix."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from test_datasets import CURVE, block, own_layers, without_checksums

from needlefit.datasets.columns import SCAN_COLUMNS
from needlefit.datasets.read import check, read
from needlefit.errors import DataError


@pytest.fixture
def folder(tmp_path):
    without_checksums(block(tmp_path))
    assert check(tmp_path) == []
    return tmp_path


def edit(path: Path, line: int, old: str, new: str):
    lines = path.read_text().split("\n")
    assert old in lines[line - 1], lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new, 1)
    path.write_text("\n".join(lines))


def cell(path: Path, line: int, column: str, value: str):
    lines = path.read_text().split("\n")
    cells = lines[line - 1].split(",")
    cells[lines[0].split(",").index(column)] = value
    lines[line - 1] = ",".join(cells)
    path.write_text("\n".join(lines))


def curve(path: Path, points):
    path.write_text(
        "x_mm,y_mm,z_mm\n" + "".join(",".join(f"{v:.5f}" for v in point) + "\n" for point in points)
    )


def the_fault(folder):
    faults = check(folder)
    assert len(faults) == 1, "\n".join(map(str, faults))
    with pytest.raises(DataError, match=re.escape(faults[0].what)):
        read(folder)
    assert faults[0].fix, faults[0]
    return faults[0]


def place(fault, folder):
    return fault.where.removeprefix(f"{folder}/")


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("depth_mm", "nan", "depth_mm is 'nan'"),
        ("depth_mm", "inf", "depth_mm is 'inf'"),
        ("depth_mm", "fifty", "depth_mm is 'fifty'"),
        ("depth_mm", "", "depth_mm is empty"),
        ("depth_mm", "-50", "depth_mm is -50"),
        ("depth_mm", "0.05", "looks like metres"),
        ("depth_mm", "151", "needle is only 150 mm"),
        ("depth_mm", "60", ""),
        ("medium", "jelly", "medium 'jelly' is unknown"),
        ("bevel_side", "left", "bevel_side is 'left'"),
        ("bevel_side", "2", "bevel_side is unknown"),
        ("bevel_x", "1", "bevel_x, bevel_y, bevel_z"),
        (("bevel_x", "bevel_y", "bevel_z"), ("2", "0", "0"), "parallel"),
        ("layers", "2.5", "not a count"),
        ("entry_dx", "0", "length 0"),
        ("entry_dx", "2", "length 2"),
        ("entry_x_mm", "nan", "entry_x_mm is 'nan'"),
        ("pose_source", "guess", "pose_source is 'guess'"),
        ("pose_source", "none", "pose_source is 'none'"),
        ("pose_shift_sd_mm", "-1", "pose_shift_sd_mm is negative"),
        ("depth_sd_mm", "-0.1", "depth_sd_mm is negative"),
        ("guide_distance_mm", "110", "guide_distance_mm is 110"),
        ("id", "../a", "id is '../a'"),
    ],
)
def test_faults_of_a_cell_of_a_row(folder, column, value, words):
    several = isinstance(column, tuple)
    for name, text in zip(column, value, strict=True) if several else [(column, value)]:
        cell(folder / "insertions.csv", 2, name, text)
    fault = the_fault(folder)
    assert words in fault.what and fault.expected
    assert place(fault, folder) == ("centerlines/a.csv:2" if value == "60" else "insertions.csv:2")


def test_duplicate_ids_name_both_lines(folder):
    cell(folder / "insertions.csv", 4, "id", "a")
    fault = the_fault(folder)
    assert place(fault, folder) == "insertions.csv:4" and "line 2" in fault.what


@pytest.mark.parametrize("layers", ["3", "5"])
def test_layers_that_are_not_met(folder, layers):
    for column in ("layers", "layers_alternative"):
        cell(folder / "insertions.csv", 2, column, layers)
    fault = the_fault(folder)
    assert "a meets 4 layers (1 > 2 > 3 > 2" in fault.what and "4" in fault.expected
    assert "layers = 4" in fault.fix


def test_the_alternative_reading_is_enough(folder):
    cell(folder / "insertions.csv", 2, "layers", "3")
    assert check(folder) == []


@pytest.mark.parametrize(("boundary", "layers"), [(-0.3, "1"), (0.3, "2")])
@pytest.mark.parametrize(("sd", "near"), [("0.2", True), ("0.1", False)])
def test_a_tip_near_a_boundary_has_a_proposed_alternative(folder, boundary, layers, sd, near):
    dataset = read(folder)
    (tip,) = (one.planar[-1, 0] for one in dataset.insertions if one.id == "a")
    text = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(f"{text}\n[media.cut]\nboundaries_mm = [{tip + boundary:.4f}]\n")
    met = "2" if boundary < 0 else "1"
    for column, value in {"medium": "cut", "layers_alternative": layers, "boundary_sd_mm": sd}.items():
        cell(folder / "insertions.csv", 2, column, value)
    cell(folder / "insertions.csv", 2, "layers", layers)
    fault = the_fault(folder)
    assert ("layers_alternative" in fault.fix) == near and met in fault.fix


def test_a_missing_column_is_named_with_those_there(folder):
    edit(folder / "insertions.csv", 1, "depth_mm", "depth")
    fault = the_fault(folder)
    assert "`depth_mm`" in fault.what and "depth," in fault.expected and "columns" in fault.fix


@pytest.mark.parametrize(
    ("value", "words"),
    [("nan", "y_mm is 'nan'"), ("-inf", "y_mm is '-inf'"), ("1.2.3", "'1.2.3'"), ("", "empty")],
)
def test_a_wrong_cell_of_a_centreline(folder, value, words):
    cell(folder / "centerlines" / "b.csv", 42, "y_mm", value)
    fault = the_fault(folder)
    assert place(fault, folder) == "centerlines/b.csv:42" and words in fault.what


def test_lines_are_counted_as_an_editor_does(folder):
    path = folder / "centerlines" / "b.csv"
    path.write_bytes(b"\r\n" + path.read_bytes().replace(b"\n", b"\r\n\r\n"))
    lines = path.read_bytes().split(b"\r\n")
    lines[10 - 1] += b"x"
    assert lines[10 - 1].count(b",") == 2
    path.write_bytes(b"\r\n".join(lines))
    assert place(the_fault(folder), folder) == "centerlines/b.csv:10"


def test_many_bad_cells_are_listed_and_counted(folder):
    curve(folder / "centerlines" / "b.csv", CURVE * [1, np.nan, 1])
    faults = check(folder)
    assert len(faults) == 6 and "96 more" in faults[-1].what


FOLDED = np.vstack([CURVE[:60], CURVE[40:]])
SWAPPED = CURVE[[*range(50), 51, 50, *range(52, 101)]]


@pytest.mark.parametrize(
    ("points", "line", "words", "fix"),
    [
        (SWAPPED, 53, "goes back", "sort"),
        (FOLDED, 62, "goes back", "sort"),
        (CURVE[np.random.default_rng(0).permutation(101)], None, "goes back", "sort"),
        (CURVE[[*range(50), 49, *range(50, 101)]], 52, "repeats the point before", "remove"),
        (CURVE[::-1], 2, "from tip to entry", "reverse"),
        (CURVE / 1000, 2, "looks like metres", "1000"),
        (CURVE / 10, 2, "looks like centimetres", "10"),
        (CURVE[:80], 2, "is 39.5", "tip"),
        (CURVE[[0, 50, 100]], 2, "only 3 points", ""),
        (CURVE + np.array([0, 8, 0]), 2, "8.00 mm from the entry", "LPS"),
        (
            CURVE * [1, -1, -1] @ np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1.0]]),
            2,
            "off the entry direction",
            "LPS",
        ),
    ],
)
def test_a_wrong_centreline(folder, points, line, words, fix):
    curve(folder / "centerlines" / "b.csv", points)
    faults = check(folder)
    fault = next(f for f in faults if words in f.what)
    assert fault.expected and fix in fault.fix
    assert line is None or place(fault, folder) == f"centerlines/b.csv:{line}"


def test_noise_of_measurement_is_no_fold(folder):
    rng = np.random.default_rng(5)
    curve(folder / "centerlines" / "b.csv", CURVE + rng.normal(size=CURVE.shape) * 0.05)
    assert check(folder) == []


@pytest.mark.parametrize("name", ["insertions.csv", "centerlines/b.csv", "layers/core.stl", "dataset.toml"])
def test_a_missing_file(folder, name):
    (folder / name).unlink()
    fault = the_fault(folder)
    assert place(fault, folder) == name and "no such file" in fault.what


@pytest.mark.parametrize("name", ["insertions.csv", "centerlines/b.csv", "layers/core.stl"])
def test_a_wrong_checksum(tmp_path, name):
    block(tmp_path)
    path = tmp_path / name
    path.write_bytes(path.read_bytes() + b"\n")
    fault = the_fault(tmp_path)
    assert place(fault, tmp_path) == name and "checksum" in fault.what
    file = tmp_path / "dataset.toml"
    old, new = re.search(r"sha256 (\w+)", fault.expected)[1], re.search(r"write (\w+)", fault.fix)[1]
    file.write_text(file.read_text().replace(f'"{name}" = "{old}"', f'"{name}" = "{new}"'))
    assert check(tmp_path) == []  # the message says how to fix it


def mesh_of(folder, name):
    return trimesh.load_mesh(folder / "layers" / name)


def test_a_solid_that_does_not_close(folder):
    mesh = mesh_of(folder, "core.stl")
    mesh.update_faces(np.arange(len(mesh.faces)) > 3)
    mesh.export(folder / "layers" / "core.stl")
    assert "does not close" in the_fault(folder).what


def test_a_sheet_with_a_hole(folder):
    mesh = mesh_of(folder, "sheet.stl").subdivide().subdivide()
    mesh.update_faces(
        np.arange(len(mesh.faces)) != np.argmin(np.linalg.norm(mesh.triangles_center[:, 1:], axis=1))
    )
    mesh.export(folder / "layers" / "sheet.stl")
    assert "1 hole" in the_fault(folder).what


def test_a_surface_in_metres(folder):
    mesh = mesh_of(folder, "core.stl")
    mesh.apply_scale(1e-3)
    mesh.export(folder / "layers" / "core.stl")
    assert "looks like metres" in the_fault(folder).what


@pytest.mark.parametrize(("sign", "name"), [(";", "semicolons"), ("\t", "tabs")])
def test_another_delimiter(folder, sign, name):
    path = folder / "centerlines" / "b.csv"
    path.write_text(path.read_text().replace(".", ",").replace(",", sign))
    fault = the_fault(folder)
    assert name in fault.what and "commas" in fault.expected


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"x_mm,y_mm,z_mm\n", "no rows"),
        (b"x_mm,y_mm,y_mm\n1,2,3\n", "more than one column"),
        (b"x_mm,y_mm,z_mm\n1,2,3\n0,5,1,5,0,5\n", "6 cells under 3 columns"),
        (b"x_mm,y_mm,z_mm\n\xff\xfe", "cannot be read"),
    ],
)
def test_a_file_that_is_no_table(folder, content, words):
    (folder / "centerlines" / "b.csv").write_bytes(content)
    assert words in the_fault(folder).what


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('origin = "synthetic"', 'origin = "found"', "`origin`"),
        ('name = "block"', 'nom = "block"', "`nom` is unknown; did you mean `name`?"),
        ('kind = "sheet"', 'kin = "sheet"', "surfaces.1.kin` is unknown; did you mean `kind`?"),
        ("length_mm", "lenght_mm", "`needle.lenght_mm` is unknown; did you mean `length_mm`?"),
        ("schema = 1", "schema = 2", "`schema`"),
        ("centerlines/{id}.csv", "centerlines/x.csv", "must hold {id}"),
        ("[20.0, 50.5, 70.0]", "[20.0, 10.0]", "must be positive and increase"),
        ('pose = "known"', 'pose = "free"', "surfaces stand in the world"),
        ("schema = 1", "schema : 1", "line 1"),
    ],
)
def test_a_wrong_key(folder, old, new, words):
    file = folder / "dataset.toml"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))
    fault = the_fault(folder)
    assert words in fault.what and fault.where.startswith(str(file))


@pytest.mark.parametrize(("value", "unit", "right"), [("8e10", "Pa", "80"), ("80000", "MPa", "80")])
def test_a_modulus_in_another_unit(folder, value, unit, right):
    file = folder / "dataset.toml"
    file.write_text(re.sub(r"youngs_modulus_gpa = .*", f"youngs_modulus_gpa = {value}", file.read_text()))
    fault = the_fault(folder)
    assert fault.what.endswith(f"looks like {unit}") and fault.fix == f"write {right}"


def test_a_layer_number_that_is_skipped(folder):
    file = folder / "dataset.toml"
    file.write_text(file.read_text().replace("into = 3", "into = 9"))
    fault = the_fault(folder)
    line = file.read_text().split("[media.block]")[0].count("\n") + 2
    assert fault.where == f"{file}:{line}"
    assert all(part in fault.what for part in ("medium block", "layer 3", "2, 9"))


def test_a_surface_without_triangles(folder):
    (folder / "layers" / "core.stl").write_text("solid core\nendsolid core\n")
    assert the_fault(folder).where.endswith("core.stl")


def test_a_file_that_only_the_checksums_list(tmp_path):
    file = block(tmp_path)
    file.write_text(f'{file.read_text()}"notes.pdf" = "0"\n')
    assert "[checksums]" in the_fault(tmp_path).fix


def test_another_encoding_is_refused_and_utf8_expected(folder):
    path = folder / "insertions.csv"
    path.write_bytes(path.read_text().replace("one", "gr\xfcn").encode("latin-1"))
    assert "UTF-8" in the_fault(folder).fix


def test_every_fault_is_found_at_once(folder):
    cell(folder / "insertions.csv", 2, "medium", "jelly")
    cell(folder / "centerlines" / "b.csv", 7, "x_mm", "nan")
    (folder / "centerlines" / "c.csv").unlink()
    (folder / "layers" / "core.stl").write_bytes(b"")
    assert len(check(folder)) == 4
    with pytest.raises(DataError, match="has 4 faults") as error:
        read(folder)
    for words in ("insertions.csv:2", "b.csv:7", "c.csv", "core.stl", "fix: "):
        assert words in str(error.value)


# ---- what every insertion has for itself


def add_columns(path: Path, **columns: str):
    """Append columns to a table, the same cell in every row."""
    lines = path.read_text().splitlines()
    heads, cells = ",".join(columns), ",".join(columns.values())
    path.write_text("\n".join([f"{lines[0]},{heads}", *(f"{line},{cells}" for line in lines[1:])]) + "\n")


@pytest.mark.parametrize(
    ("value", "words"), [("-0.1", "sd_mm is -0.1"), ("inf", "'inf'"), ("", "empty"), ("wide", "'wide'")]
)
def test_a_wrong_deviation_of_a_point(folder, value, words):
    path = folder / "centerlines" / "b.csv"
    add_columns(path, sd_mm="0.1")
    assert check(folder) == []
    cell(path, 42, "sd_mm", value)
    fault = the_fault(folder)
    assert place(fault, folder) == "centerlines/b.csv:42" and words in fault.what


def test_an_empty_column_of_deviations_gives_none(folder):
    add_columns(folder / "centerlines" / "b.csv", sd_mm="")
    assert read(folder).insertions[1].sd is None


def test_deviations_of_another_name_must_be_there(folder):
    add_columns(folder / "centerlines" / "b.csv", error="0.1")
    file = folder / "dataset.toml"
    head = "[centerlines]\n"
    assert head in file.read_text()
    file.write_text(file.read_text().replace(head, head + 'columns = { sd_mm = "error" }\n'))
    assert {place(fault, folder) for fault in check(folder)} == {"centerlines/a.csv:1", "centerlines/c.csv:1"}
    for name in "ac":
        add_columns(folder / "centerlines" / f"{name}.csv", error="0.2")
    assert [insertion.sd[0] for insertion in read(folder).insertions] == [0.2, 0.1, 0.2]


def test_a_scan_is_placed_by_six_numbers_or_by_none(folder):
    add_columns(folder / "insertions.csv", **dict.fromkeys(SCAN_COLUMNS, ""))
    assert check(folder) == []
    cell(folder / "insertions.csv", 3, "scan_ry_deg", "12")
    fault = the_fault(folder)
    assert place(fault, folder) == "insertions.csv:3" and "scan_" in fault.what
    cell(folder / "insertions.csv", 3, "scan_ry_deg", "east")
    fault = the_fault(folder)
    assert (
        place(fault, folder) == "insertions.csv:3"
        and fault.what.startswith("scan_ry_deg")
        and "'east'" in fault.what
    )


def test_columns_of_a_scan_that_are_missing_are_named(folder):
    add_columns(folder / "insertions.csv", **dict.fromkeys(SCAN_COLUMNS[:5], "0"))
    fault = the_fault(folder)
    assert "`scan_z_mm`" in fault.what and place(fault, folder) == "insertions.csv:1"


def test_faults_of_an_insertion_s_own_layers_name_its_file(tmp_path):
    without_checksums(own_layers(tmp_path))
    (tmp_path / "layers" / "a_sheet.stl").unlink()
    fault = the_fault(tmp_path)
    assert place(fault, tmp_path) == "layers/a_sheet.stl" and "no such file" in fault.what
    own_layers(tmp_path)
    mesh = trimesh.load_mesh(tmp_path / "layers" / "b_sheet.stl")
    mesh.apply_scale(1e-3)
    mesh.export(tmp_path / "layers" / "b_sheet.stl")
    without_checksums(tmp_path / "dataset.toml")
    fault = the_fault(tmp_path)
    assert place(fault, tmp_path) == "layers/b_sheet.stl" and "metres" in fault.what
