"""The needles of the workbook, written in other layouts, become the same dataset."""

import csv

import numpy as np
import pytest
from import_cases import write_sheets as write_workbook
from scipy.io import savemat

from needlefit.datasets.importing.prepare import WORKBOOK_FILE, prepare_import
from needlefit.datasets.importing.tables import read_sheets
from needlefit.datasets.read import read
from needlefit.project.locate import read_toml
from needlefit.reporting.dataset_import import write_import

SHEETS = {one.sheet: [list(row) for row in one.rows] for one in read_sheets(WORKBOOK_FILE)}
POINTS, NEEDLES = SHEETS["example points"][1:], SHEETS["example needles"][1:]
OWN = ["needle", "bevel side", "depth [mm]", "specimen", "medium"]
SETUP = {name: (value, unit) for name, value, unit, *_ in SHEETS["example setup"][1:]}
# What rows and columns of a table may state; the others are answers about the whole import.
SHARED = ("needle length", "diameter", "inner diameter", "modulus", "boundaries", "boundary sd", "point sd",
          "entry point", "pose shift sd", "pose", "pose angle sd")  # fmt: skip
REST = {name: value for name, (value, _) in SETUP.items() if name not in SHARED}


def points_of(name):
    return [row[1:4] for row in POINTS if row[0] == name]


def write_csv(path, rows):
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)


def to_cells(row):
    return [float(cell) for cell in row]


def shared_columns():
    units = {"diameter": "", "modulus": "", "entry point": "", "pose": ""}
    heads = [f"{name} [{units.get(name, SETUP[name][1])}]".replace(" []", "") for name in SHARED]
    return heads, [SETUP[name][0] for name in SHARED]


def write_long(folder):
    """All that is known in columns of one table."""
    heads, values = shared_columns()
    own = {row[0]: row[1:] for row in NEEDLES}
    rows = [[name, *place, *own[name], *values] for name, *place in POINTS]
    write_csv(folder / "needles.csv", [["needle", "x [mm]", "y [mm]", "z [mm]", *OWN[1:], *heads], *rows])


def write_two_tables(folder):
    heads, values = shared_columns()
    write_csv(folder / "points.csv", [["needle", "x [mm]", "y [mm]", "z [mm]"], *POINTS])
    write_csv(folder / "table.csv", [[*OWN, *heads], *([*row, *values] for row in NEEDLES)])


def write_wide(folder):
    """Needles side by side, and a table with a row for each."""
    names = [row[0] for row in NEEDLES]
    blocks = [points_of(name) for name in names]
    rows = [[cell for name in names for cell in (name, "", "")], ["x [mm]", "y [mm]", "z [mm]"] * len(names)]
    for n in range(max(map(len, blocks))):
        rows.append([cell for one in blocks for cell in (one[n] if n < len(one) else ["", "", ""])])
    write_csv(folder / "wide.csv", rows)
    heads, values = shared_columns()
    write_csv(folder / "table.csv", [[*OWN, *heads], *([*row, *values] for row in NEEDLES)])


def write_sheets(folder):
    """One sheet a needle, what is known of it above its points."""
    heads, values = shared_columns()
    sheets = {}
    for name, *own in NEEDLES:
        above = [[head, value] for head, value in zip([*OWN[1:], *heads], [*own, *values], strict=True)]
        sheets[name] = [*above, ["x [mm]", "y [mm]", "z [mm]"], *map(to_cells, points_of(name))]
    write_workbook(folder / "sheets.xlsx", **sheets)


def write_shared_sheet(folder):
    """Points, needles, and one row of what all needles share on a sheet of its own."""
    points = [["needle", "x [mm]", "y [mm]", "z [mm]"], *([one[0], *to_cells(one[1:4])] for one in POINTS)]
    heads, values = shared_columns()
    write_workbook(folder / "book.xlsx", a=points, b=[OWN, *NEEDLES], c=[heads, values])


def write_mat(folder):
    """An array of structs beside what all needles share."""
    fields = ("name", "bevel_side", "depth", "specimen", "medium", "points")
    array = np.empty(len(NEEDLES), dtype=[(name, object) for name in fields])
    for n, (name, side, depth, *own) in enumerate(NEEDLES):
        array[n] = (name, float(side), float(depth), *own, np.array(points_of(name), dtype=float))
    shared = {name.replace(" ", "_"): SETUP[name][0] for name in SHARED}
    savemat(folder / "needles.mat", {"needles": array, **shared})


def write_blocks(folder):
    """A text of blocks; what all needles share stands above the first one."""
    heads, values = shared_columns()
    lines = [f"{head}: {value}" for head, value in zip(heads, values, strict=True)]
    for name, *own in NEEDLES:
        lines += ["", f"needle: {name}"]
        lines += [f"{head}: {value}" for head, value in zip(OWN[1:], own, strict=True)]
        lines += ["x [mm]\ty [mm]\tz [mm]", *("\t".join(place) for place in points_of(name))]
    (folder / "blocks.txt").write_text("\n".join(lines), encoding="utf-8")


def import_folder(paths, out, **stated):
    write_import(out, prepare_import(paths, [*stated.items()]))
    return out


@pytest.fixture(scope="module")
def wanted(tmp_path_factory):
    return import_folder([WORKBOOK_FILE], tmp_path_factory.mktemp("workbook") / "gel")


LAYOUTS = [
    write_long,
    write_two_tables,
    write_wide,
    write_sheets,
    write_shared_sheet,
    write_mat,
    write_blocks,
]


@pytest.mark.parametrize("write", LAYOUTS)
def test_the_needles_of_the_workbook_in_another_layout_are_the_same_dataset(tmp_path, wanted, write):
    source = tmp_path / "source"
    source.mkdir()
    write(source)
    stated = {name.replace(" ", "_"): value for name, value in REST.items()}
    found = import_folder([source], tmp_path / "gel", **stated | {"unit": "mm", "origin": "example"})
    names = sorted(path.relative_to(wanted) for path in wanted.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(found) for path in found.rglob("*") if path.is_file())
    for name in (one for one in names if one.name not in ("dataset.toml", "mapping.toml", "import.png")):
        assert (found / name).read_bytes() == (wanted / name).read_bytes(), name
    assumed = read_toml(found / "mapping.toml").get("assumed", {})
    assert all(key.endswith(".unit") for key in assumed)  # of headers that state none
    records = [read_toml(folder / "dataset.toml") for folder in (found, wanted)]
    assert all(record.pop("import")["mapping"] == "mapping.toml" for record in records)
    assert records[0] == records[1] and len(read(found).insertions) == len(NEEDLES)
    again = tmp_path / "again" / "gel"
    again.parent.mkdir()
    write_import(again, prepare_import([source], mapping=found / "mapping.toml"))
    assert all((again / name).read_bytes() == (found / name).read_bytes() for name in names)
