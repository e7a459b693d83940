"""Files of other programs, written by hand: tables, workbooks, MATLAB files, markups and surfaces."""

import json
import zipfile
from pathlib import Path

import h5py
import numpy as np

from needlefit.datasets.importing.files import read_content
from needlefit.datasets.importing.planning import Planner


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


def write_workbook(path: Path, curves):
    from datetime import datetime

    from openpyxl import Workbook

    book = Workbook()
    book.properties.created = book.properties.modified = datetime(2024, 1, 1)
    sheet = book.active
    sheet.title = "Nadeln"
    sheet.append(["Nadelversuch"])
    sheet.append([cell for n in range(1, len(curves) + 1) for cell in (f"Nadel {n}", None, None)])
    sheet.append(["x (mm)", "y (mm)", "z (mm)"] * len(curves))
    for row in wide_rows(curves, float):
        sheet.append([None if cell == "" else cell for cell in row])
    book.create_sheet("Notizen").append(["von", "mir"])
    book.save(path)
    with zipfile.ZipFile(path) as archive:
        members = {one.filename: archive.read(one) for one in archive.infolist()}
    with zipfile.ZipFile(path, "w") as archive:  # without the time of day
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)


def write_struct_array(path: Path, name, fields, rows, **numbers):
    """An array of structs as MATLAB 7.3 stores it: every field an array of references, matrices turned."""
    with h5py.File(path, "w") as file:
        group, hidden = file.create_group(name), file.create_group("#refs#")
        for column, key in enumerate(fields):
            references = []
            for n, row in enumerate(rows):
                value, is_text = row[column], isinstance(row[column], str)
                data = np.array([[ord(one)] for one in value], "u2") if is_text else np.atleast_2d(value).T
                item = hidden.create_dataset(f"{key}{n}", data=data)
                item.attrs["MATLAB_class"] = np.bytes_("char" if is_text else "double")
                references.append([item.ref])
            group.create_dataset(key, data=np.array(references, dtype=h5py.ref_dtype), dtype=h5py.ref_dtype)
        for key, number in numbers.items():
            file[key] = np.array([[number]])


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


def plan_import(paths, answers, columns=""):
    content = read_content(paths, columns)
    return content, Planner(content, answers).make_plan()
