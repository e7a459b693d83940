"""Files of other programs, written by hand: tables, workbooks, MATLAB files, markups and surfaces."""

import json
from pathlib import Path

import numpy as np

from needlefit.datasets.importing.prepare import complete_draft, prepare_import
from needlefit.datasets.importing.read import read_mapped
from needlefit.reporting.dataset_import import write_import


def needle(n=0, points=16, depth=60.0):
    """An arc along x from an entry of its own."""
    s = np.linspace(0.0, depth - 5.0 * n, points)
    return np.column_stack([s, 3.0 * n + (4e-4 + 1e-4 * n) * s**2, np.zeros(points)])


def german(value):
    return f"{value:.4f}".replace(".", ",")


def wide_rows(curves, number=german):
    """Curves side by side; shorter ones end with empty cells."""
    rows = []
    for n in range(max(map(len, curves))):
        points = [one[n] if n < len(one) else None for one in curves]
        rows.append([cell for p in points for cell in ([""] * 3 if p is None else map(number, p))])
    return rows


def write_european_csv(path: Path, curves):
    head = [
        "Messung vom 3. März;" + ";" * 10,
        ";".join(f"Nadel {n};;" for n in range(1, len(curves) + 1)),
        ";".join(["x;y;z"] * len(curves)),
        ";".join(["mm"] * 3 * len(curves)),
    ]
    lines = [*head, *(";".join(row) for row in wide_rows(curves))]
    path.write_bytes("\r\n".join(lines).encode("latin-1"))


def markups(name, points, kind="Curve", system="LPS"):
    signs = [-1, -1, 1] if system == "RAS" else [1, 1, 1]
    return {
        "type": kind,
        "name": name,
        "coordinateSystem": system,
        "controlPoints": [
            {"label": str(n), "position": (point * signs).tolist()} for n, point in enumerate(points)
        ],
    }


def write_markups(path: Path, name, points, kind="Curve", system="LPS"):
    schema = "https://x/markups-schema-v1.0.3.json#"
    path.write_text(json.dumps({"@schema": schema, "markups": [markups(name, points, kind, system)]}))


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


def prepare(paths, **stated):
    """Prepare an import of which keys are stated: `y__column` is y.column."""
    return prepare_import(paths, [(key.replace("__", "."), value) for key, value in stated.items()])


def placed(paths, **stated):
    """Return what was read, the plan, and what holds of all needles by key: value, and assumed or stated."""
    prepared = prepare(paths, **stated)
    mapping = prepared.mapping
    made = {key: (mapping.values.get(key, ""), "assumed") for key in mapping.assumed}
    made |= {key: (value, "stated") for key, value in mapping.values.items() if key not in mapping.assumed}
    return prepared.content, prepared.plan, made | {what: (text, "files") for what, text in prepared.notes}


def planned(paths, **stated):
    """Return the plan, and what holds of all needles by key."""
    return placed(paths, **stated)[1:]


def write_placed(folder, paths, **stated):
    """Import files; return the folder."""
    write_import(folder, prepare(paths, **stated))
    return folder


def curves_of(paths, **stated):
    """Return the needles that files hold, by name, before they are placed."""
    assignments = [(key.replace("__", "."), value) for key, value in stated.items()]
    draft, files = complete_draft([*paths], assignments)
    content = read_mapped(draft.to_record("draft"), files, "draft")
    return {one.name: one for one in content.curves}, draft


def write_long(folder, curves, name="points.csv", head=(), cells=()):
    """Write curves `n1`, `n2`, ... to a long table, mm, with more columns before the coordinates."""
    rows = [["needle", *head, "x [mm]", "y [mm]", "z [mm]"]]
    for n, curve in enumerate(curves):
        own = cells[n] if cells else ()
        rows += [[f"n{n + 1}", *own, *(f"{value:.8g}" for value in point)] for point in curve]
    (folder / name).write_text("\n".join(",".join(map(str, row)) for row in rows), encoding="utf-8")
    return folder / name


def write_rows(path, rows):
    path.write_text("\n".join(",".join(map(str, row)) for row in rows), encoding="utf-8")
    return path
