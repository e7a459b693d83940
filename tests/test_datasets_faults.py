"""Every fault of a dataset, made in a real one: named with file, line, what was expected, how to fix."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.random import default_rng
from refusals import refusal
from test_datasets import CURVE, block, without_checksums

from needlefit.datasets.columns import SCAN_COLUMNS
from needlefit.datasets.read import check, read
from needlefit.errors import DataError

ROWS, A, B = "insertions.csv", "centerlines/a.csv", "centerlines/b.csv"
CORE, TOML = "layers/core.stl", "dataset.toml"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return Path(block(tmp_path_factory.mktemp("block"))).parent


@pytest.fixture
def folder(made, tmp_path):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    without_checksums(tmp_path / TOML)
    return tmp_path


def the_fault(folder):
    faults = check(folder)
    assert len(faults) == 1, "\n".join(map(str, faults))
    refusal(DataError, re.escape(faults[0].what), read, folder)
    assert faults[0].fix, faults[0]
    return faults[0]


def place(fault, folder):
    return fault.where.removeprefix(f"{folder}/")


# ---- changes of a dataset


def cell(name, line, **values):
    def change(folder):
        lines = (folder / name).read_text().split("\n")
        cells = lines[line - 1].split(",")
        for column, value in values.items():
            cells[lines[0].split(",").index(column)] = value
        lines[line - 1] = ",".join(cells)
        (folder / name).write_text("\n".join(lines))

    return change


def row(**values):
    return cell(ROWS, 2, **values)


def text(name, old, new):
    def change(folder):
        before = (folder / name).read_text()
        assert old in before
        (folder / name).write_text(before.replace(old, new, 1))

    return change


def content(name, data):
    return lambda folder: (folder / name).write_bytes(data)


def delete(name):
    return lambda folder: (folder / name).unlink()


def points(values):
    lines = "".join(",".join(f"{v:.5f}" for v in point) + "\n" for point in values)
    return content(B, f"x_mm,y_mm,z_mm\n{lines}".encode())


def mesh(name, edit):
    def change(folder):
        surface = trimesh.load_mesh(folder / name)
        edit(surface)
        surface.export(folder / name)

    return change


def add_columns(name, **columns):
    """Append columns to a table, the same cell in every row."""

    def change(folder):
        lines = (folder / name).read_text().splitlines()
        heads, cells = ",".join(columns), ",".join(columns.values())
        rows = [f"{lines[0]},{heads}", *(f"{line},{cells}" for line in lines[1:])]
        (folder / name).write_text("\n".join(rows) + "\n")

    return change


def use_semicolons(folder):
    (folder / B).write_text((folder / B).read_text().replace(".", ";").replace(",", ";"))


def blank_lines(folder):
    path = folder / B
    path.write_bytes(b"\r\n" + path.read_bytes().replace(b"\n", b"\r\n\r\n"))
    lines = path.read_bytes().split(b"\r\n")
    lines[10 - 1] += b"x"
    path.write_bytes(b"\r\n".join(lines))


SCAN = dict.fromkeys(SCAN_COLUMNS, "")


def scan(value):
    def change(folder):
        add_columns(ROWS, **SCAN)(folder)
        cell(ROWS, 3, scan_ry_deg=value)(folder)

    return change


def own(line, **values):
    """Add columns to the table of insertions, empty but for one line."""

    def change(folder):
        add_columns(ROWS, **dict.fromkeys(values, ""))(folder)
        cell(ROWS, line, **values)(folder)

    return change


THIN = "[needles.22G]\nlength_mm = 40.0\nflexural_rigidity_nmm2 = 2e3\n"


def with_thin(change):
    def add(folder):
        (folder / TOML).write_text(f"{(folder / TOML).read_text()}\n{THIN}")
        change(folder)

    return add


FAULTS = [
    *((f"{ROWS}:2", row(**cells)) for cells in (
        *({"depth_mm": value} for value in ("nan", "", "0.05", "151")), {"medium": "jelly"}, {"bevel_x": "1"},
        {"bevel_x": "2", "bevel_y": "0", "bevel_z": "0"}, {"entry_dx": "2"}, {"pose_source": "none"},
        {"guide_distance_mm": "110"}, {"id": "../a"}, {"specimen": "=1+1"},
        {"layers": "5", "layers_alternative": "5"})),
    (f"{A}:2", row(depth_mm="60")),
    (f"{ROWS}:4", cell(ROWS, 4, id="a")),
    # needles and boundaries of single insertions
    (f"{ROWS}:2", own(2, needle="25G")),
    (f"{ROWS}:2", with_thin(own(2, needle="22G"))),
    (TOML, with_thin(text(TOML, 'name = "needle"', 'name = "22G"'))),
    *((f"{ROWS}:3", own(3, boundaries_mm=value)) for value in ("18;inf", "36;18")),
    (f"{ROWS}:2", own(2, boundaries_mm="18")),
    (f"{ROWS}:1", text(ROWS, "depth_mm", "depth")),
    (f"{ROWS}:3", scan("12")),
    (f"{ROWS}:1", add_columns(ROWS, **dict.fromkeys(SCAN_COLUMNS[:5], "0"))),
    # cells of a centreline
    *((f"{B}:42", cell(B, 42, y_mm=value)) for value in ("nan", "1.2.3")),
    (f"{B}:42", lambda folder: (add_columns(B, sd_mm="0.1")(folder), cell(B, 42, sd_mm="-0.1")(folder))),
    (f"{B}:10", blank_lines),
    # files
    *((name, delete(name)) for name in (B, TOML)),
    (f"{B}:1", use_semicolons),
    *((B, content(B, b"x_mm,y_mm,z_mm\n" + data)) for data in (b"", b"1,2,3\n0,5,1,5,0,5\n", b"\xff\xfe")),
    # surfaces
    (CORE, mesh(CORE, lambda one: one.update_faces(np.arange(len(one.faces)) > 3))),
    (CORE, mesh(CORE, lambda one: one.apply_scale(1e-3))),
    # keys
    *((TOML, text(TOML, old, new)) for old, new in (
        ('kind = "sheet"', 'kin = "sheet"'), ("centerlines/{id}.csv", "centerlines/x.csv"),
        ('pose = "known"', 'pose = "free"'), ("schema = 1", "schema : 1"))),
]  # fmt: skip


@pytest.mark.parametrize(("where", "change"), FAULTS)
def test_a_fault_is_named_with_its_place_and_its_fix(folder, where, change):
    change(folder)
    fault = the_fault(folder)
    assert fault.what and place(fault, folder).startswith(where)


def test_what_is_no_fault_and_many_bad_cells(folder):
    assert check(folder) == []
    row(layers="3")(folder)
    assert check(folder) == []
    points(CURVE + default_rng(5).normal(size=CURVE.shape) * 0.05)(folder)
    assert check(folder) == []
    points(CURVE * [1, np.nan, 1])(folder)
    faults = check(folder)
    assert len(faults) == 6 and "96 more" in faults[-1].what


FOLDED = np.vstack([CURVE[:60], CURVE[40:]])
SWAPPED = CURVE[[*range(50), 51, 50, *range(52, 101)]]
ACROSS = CURVE * [1, -1, -1] @ np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1.0]])


@pytest.mark.parametrize(
    ("values", "line", "words"),
    [
        (SWAPPED, 53, "out of order"),
        (FOLDED, 62, "out of order"),
        (CURVE[default_rng(0).permutation(101)], None, "out of order"),
        (CURVE[[*range(50), 49, *range(50, 101)]], 52, "repeats the point before"),
        (CURVE[::-1], 2, "from tip to entry"),
        (CURVE / 1000, 2, "looks like metres"),
        (CURVE / 10, 2, "looks like centimetres"),
        (CURVE[:80], 2, "is 39.5"),
        (CURVE[[0, 50, 100]], 2, "only 3 points"),
        (CURVE + np.array([0, 8, 0]), 2, "8.00 mm from the entry"),
        (ACROSS, 2, "off the entry direction"),
    ],
)
def test_a_wrong_centreline(folder, values, line, words):
    points(values)(folder)
    fault = next(fault for fault in check(folder) if words in fault.what)
    assert fault.expected and fault.fix
    assert line is None or place(fault, folder) == f"{B}:{line}"


@pytest.mark.parametrize("name", [ROWS, B, CORE])
def test_a_wrong_checksum(made, tmp_path, name):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes() + b"\n")
    fault = the_fault(tmp_path)
    assert place(fault, tmp_path) == name and "checksum" in fault.what
    old, new = re.search(r"sha256 (\w+)", fault.expected)[1], re.search(r"write (\w+)", fault.fix)[1]
    text(TOML, f'"{name}" = "{old}"', f'"{name}" = "{new}"')(tmp_path)
    assert check(tmp_path) == []  # the message says how to fix it


def test_a_layer_number_that_is_skipped(folder):
    text(TOML, "into = 3", "into = 9")(folder)
    fault = the_fault(folder)
    assert fault.where == f"{folder / TOML}, key `media.block.surfaces`"
    assert all(part in fault.what for part in ("medium block", "layer 3", "2, 9"))


def test_deviations_may_be_empty_or_of_another_name(folder):
    add_columns(B, sd_mm="")(folder)
    assert read(folder).insertions[1].sd is None
    add_columns(B, error="0.1")(folder)
    text(TOML, "[centerlines]\n", '[centerlines]\ncolumns = { sd_mm = "error" }\n')(folder)
    assert {place(fault, folder) for fault in check(folder)} == {f"{A}:1", "centerlines/c.csv:1"}
    for name in (A, "centerlines/c.csv"):
        add_columns(name, error="0.2")(folder)
    assert [insertion.sd[0] for insertion in read(folder).insertions] == [0.2, 0.1, 0.2]
    add_columns(ROWS, **SCAN)(folder)
    assert check(folder) == []
