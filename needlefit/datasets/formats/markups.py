"""Read the markup files of 3D Slicer, `.mrk.json` (schema 1.0.x) and `.fcsv`; write `.mrk.json`."""

import csv
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.faults import Fault
from needlefit.datasets.formats import FileFormat, ReadCurves
from needlefit.datasets.point_labels import divide_labels
from needlefit.datasets.points import MAX_COORDINATE, Points
from needlefit.errors import DataError
from needlefit.geometry.curves import make_normal
from needlefit.geometry.frames import PatientSystem, normalize, to_lps
from needlefit.project.input_files import read_json, read_once, read_text
from needlefit.project.units import UNITS_MM

# schema that Slicer itself writes: an identifier, no address
SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
CURVE_KINDS = ("Curve", "Fiducial")  # kinds of lists whose points, in their order, can be a centreline
SAVE_AGAIN_FIX = "save the list again in Slicer, as Markups JSON"

# Columns of a .fcsv file that does not name them; from Slicer 5 on one follows with the status of the point.
FCSV_COLUMNS = ("id", "x", "y", "z", "ow", "ox", "oy", "oz", "vis", "sel", "lock", "label", "desc", "node")
FCSV_KEYS = {"label": "label", "description": "desc"}
# coordinate systems by their numbers, which stood in files until 2019
FCSV_SYSTEMS = {"0": "RAS", "1": "LPS"}
FCSV_DEFINED = "2"  # status of a point that was placed
MAX_FCSV_CHARS = 10_000  # longest line that is read (characters)
_FCSV_HEADER = re.compile(r"#\s*([^=]*?)\s*=\s*(.*?)\s*$")

_SCHEMA = re.compile(r"markups-schema-v1\.\d+\.\d+\.json#*$", re.IGNORECASE)


@dataclass(frozen=True)
class CurveStyle:
    """How 3D Slicer shows a list: colour (red, green, blue; 0 to 1), thickness of its line, mm."""

    colour: tuple[float, float, float]
    thickness: float = 0.5
    locked: bool = True  # whether its points cannot be moved; their labels are shown where they can


@dataclass(frozen=True)
class Markups:
    """One markup list of 3D Slicer."""

    path: Path  # where it stands
    name: str  # of the list; the file's where it has none
    kind: str  # "Fiducial", "Curve", "ClosedCurve", "Line", ...
    labels: tuple[str, ...]  # of the points, N of them
    # (N, 3); LPS, mm. Locked, hidden and unselected points are among them: that is how they are shown, no
    # more.
    points: Floats
    system: PatientSystem = "LPS"  # the coordinate system of the file, from which they were turned
    unset: tuple[str, ...] = ()  # labels of the points that were never placed; `points` leaves them out
    descriptions: tuple[str, ...] = ()  # of the points, N of them

    def as_curve(self) -> Points:
        """Return the points as a centreline; DataError if the list is not a curve."""
        if self.kind in CURVE_KINDS:
            return Points(self.path, self.points)
        raise DataError(
            f"`{self.name}` is a {self.kind}, which is no centreline",
            expected="an open curve (Curve), or points (Fiducial) from the entry to the tip",
            fix="draw the needle as an open curve, or leave out the file if it is no needle",
            where=self.path,
        )


def read_markups(path: Path, with_planes: bool = False) -> tuple[Markups, ...]:
    """Read every list of points of a `.mrk.json` or `.fcsv` file; boxes (ROI) and, unless asked for, planes
    are skipped.

    DataError if the file is missing, no markups file, or holds no list of points; if a list is empty, does
    not state its coordinate system, or has a point that is not finite.
    """
    if path.suffix.lower() == ".fcsv":
        return (_parse_markups(path, _read_fcsv(path), 1),)
    whole = _read_lists(path)
    lists = whole.get("markups") if isinstance(whole, dict) else None
    if not isinstance(lists, list) or not all(isinstance(table, dict) for table in lists):
        raise DataError(
            "has no `markups`",
            expected='{"@schema": ..., "markups": [{"type": "Curve", ...}]}',
            fix=SAVE_AGAIN_FIX,
            where=path,
        )
    schema = str(whole.get("@schema", SCHEMA))
    if not _SCHEMA.search(schema):
        raise DataError(
            f"its schema is {schema[:120]!r}",
            expected="markups-schema-v1.x.y.json",
            fix=SAVE_AGAIN_FIX,
            where=path,
        )
    parsed = [
        _parse_markups(path, table, n)
        for n, table in enumerate(lists, 1)
        if table.get("type") not in (("ROI",) if with_planes else ("ROI", "Plane"))
    ]
    if not parsed:
        kinds = ", ".join(str(table.get("type")) for table in lists) or "nothing"
        raise DataError(
            f"holds no list of points, but {kinds}",
            expected="a point list, a Curve or a Line",
            fix="save such a list in Slicer",
            where=path,
        )
    return tuple(parsed)


_read_lists = read_once(read_json)


@read_once
def _read_fcsv(path: Path) -> dict[str, Any]:
    """Return the one list of a `.fcsv` file (Slicer 4 or later) as `.mrk.json` states it."""
    header: dict[str, str] = {"columns": ",".join(FCSV_COLUMNS)}
    points = []
    for line in read_text(path).splitlines():
        if match := _FCSV_HEADER.match(line):
            header[match[1].lower()] = match[2]
        elif line.strip() and not line.startswith("#"):
            columns = header["columns"].replace(" ", "").split(",")
            cells = [cell.strip() for cell in next(csv.reader([line.replace("\0", "")[:MAX_FCSV_CHARS]]))]
            named = dict(zip(columns, cells, strict=False))
            point: dict[str, Any] = {key: named.get(short) for key, short in FCSV_KEYS.items()}
            point["position"] = [_to_float(named.get(axis, "")) for axis in "xyz"]
            if cells[len(FCSV_COLUMNS) : len(FCSV_COLUMNS) + 1] not in ([], [""], [FCSV_DEFINED]):
                point["positionStatus"] = "undefined"
            points.append(point)
    system = header.get("coordinatesystem")
    return {
        **{"type": "Fiducial", "name": path.stem, "controlPoints": points},
        "coordinateSystem": FCSV_SYSTEMS.get(system, system) if system else None,
    }


def _to_float(text: str) -> float | str:
    """Return a cell as a number; or the cell itself if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return text


def _is_place(value: Any) -> bool:  # noqa: ANN401 - whatever a file holds
    is_triple = isinstance(value, list) and len(value) == 3
    return is_triple and all(type(x) in (int, float) and abs(x) <= MAX_COORDINATE for x in value)


def _parse_markups(path: Path, table: Mapping[str, Any], number: int) -> Markups:
    def check(is_right: bool, key: str, expected: str) -> None:
        if not is_right:
            raise DataError(
                f"list {number}, key `{key}` is missing or wrong",
                expected=expected,
                fix=SAVE_AGAIN_FIX,
                where=path,
            )

    kind, system, points = (table.get(key) for key in ("type", "coordinateSystem", "controlPoints"))
    units = table.get("coordinateUnits") or "mm"
    unit = units[0] if isinstance(units, list) else units  # scheme and meaning may stand behind the code
    check(isinstance(kind, str), "type", "Fiducial, Curve, ...")
    check(system in ("LPS", "RAS"), "coordinateSystem", "LPS or RAS")
    check(isinstance(unit, str) and unit in UNITS_MM, "coordinateUnits", f"one of {', '.join(UNITS_MM)}")
    is_list = isinstance(points, list) and all(isinstance(point, dict) for point in points)
    check(is_list, "controlPoints", "a list of points")
    placed, unset, positions = list[dict[str, Any]](), list[str](), list[list[float]]()
    for n, point in enumerate(points or (), start=1):
        position, status = point.get("position"), point.get("positionStatus", "defined")
        key = f"controlPoints.{n}.position"
        check(
            status in ("defined", "undefined", "preview", "missing"), f"{key}Status", "defined or undefined"
        )
        if not position or status != "defined":
            unset.append(str(point.get("label") or ""))
            continue
        check(_is_place(position), key, f"three numbers up to {MAX_COORDINATE:g}")
        placed.append(point)
        positions.append(position)
    if kind == "Plane" and {"center", "normal"} <= table.keys():  # its control points are handles
        check(all(map(_is_place, (table["center"], table["normal"]))), "center", "three numbers, as `normal`")
        side = make_normal(normal := normalize(table["normal"]))
        positions = [
            (np.array(table["center"]) + step).tolist() for step in (0.0 * side, side, np.cross(normal, side))
        ]
    name = str(table.get("name") or path.name.removesuffix(".json").removesuffix(".mrk"))
    if not placed:
        problem = f"list `{name}` is empty" + (
            f": its {len(unset)} points were never placed" if unset else ""
        )
        raise DataError(
            problem,
            expected="a list with points",
            fix="place its points in Slicer and save it again",
            where=path,
        )
    labels, notes = (tuple(str(point.get(key) or "") for point in placed) for key in ("label", "description"))
    stated: PatientSystem = "LPS" if system == "LPS" else "RAS"
    values = to_lps(UNITS_MM[unit] * np.array(positions, dtype=np.float64), stated)
    return Markups(path, name, str(kind), labels, values, stated, tuple(unset), notes)


def holds_markups(path: Path) -> bool:
    """Whether a file is one of Slicer by its ending, or a `.json` file by what it holds."""
    if path.suffix.lower() != ".json" or path.name.lower().endswith(".mrk.json"):
        return path.suffix.lower() in (".json", ".fcsv")
    try:
        whole = _read_lists(path)
    except DataError:
        return False
    return isinstance(whole, dict) and "markups" in whole


def read_plane(path: Path) -> Points:
    """Return the points of the one plane or list of a file; DataError if there are several."""
    return Points(path, pick_list(read_markups(path, with_planes=True), path).points)


def is_plane(path: Path) -> bool:
    """Whether a file holds one plane of Slicer, and nothing else."""
    is_markups = path.suffix.lower() == ".json" and holds_markups(path)
    return is_markups and [markups.kind for markups in read_markups(path, with_planes=True)] == ["Plane"]


def pick_list(lists: Sequence[Markups], path: Path) -> Markups:
    """Return the only list of a file; DataError if there are several."""
    if len(lists) == 1:
        return lists[0]
    listed = ", ".join(f"`{markups.name}` ({markups.kind})" for markups in lists)
    raise DataError(
        f"holds {len(lists)} lists: {listed}",
        expected="one list",
        fix="save the list that is meant on its own",
        where=path,
    )


def _read_curves(path: Path) -> ReadCurves:
    lists = read_markups(path)
    unset = sum(len(markups.unset) for markups in lists)
    curves = [
        markups for markups in lists if markups.kind in CURVE_KINDS
    ] or lists  # another kind is refused by its name
    notes = [f"{unset} points without a position ignored"] if unset else []
    named = list[tuple[str, Points]]()
    for markups in curves:
        whole, groups = markups.as_curve(), _divide(markups)
        stem = "" if len(curves) == 1 else f"{markups.name}-"
        named += [(f"{stem}{name}", whole.part(np.array(rows))) for name, rows in groups.items()]
        named += [] if groups else [(markups.name, whole)]
        if groups:
            listed = ", ".join(f"{name} ({len(rows)})" for name, rows in groups.items())
            notes.append(f"points by their labels: {listed}")
    counts = Counter(name for name, _ in named)
    for name, count in counts.most_common(1):
        if count > 1:
            raise DataError(
                f"holds {count} lists called `{name}`",
                expected="names that differ: they become ids",
                fix="rename them in Slicer, and save them again",
                where=path,
            )
    return dict(named), notes


def _divide(markups: Markups) -> dict[str, list[int]]:
    return divide_labels(markups.labels) if markups.kind == "Fiducial" else {}


def _read_centerline(path: Path, _columns: Mapping[str, str], _found: list[Fault]) -> Points:
    lists = read_markups(path)
    curves = [markups for markups in lists if markups.kind == "Curve"]
    return (curves[0] if len(curves) == 1 else pick_list(lists, path)).as_curve()


MARKUPS = FileFormat(
    "markups",
    (".mrk.json", ".json", ".fcsv"),
    _read_curves,
    _read_centerline,
    lambda path: Points(path, pick_list(read_markups(path), path).points),
    in_scan=True,
    is_of_format=holds_markups,
)


# ---- write


def write_mrk_json(path: Path, lists: Iterable[tuple[Markups, CurveStyle]]) -> None:
    """Write lists to one file that Slicer opens as one node each: LPS, mm, all digits.

    The same lists give the same bytes.
    """
    texts = [_format_markups(markups, style) for markups, style in lists]
    body = ",\n".join(texts)
    path.write_bytes(f'{{\n"@schema": "{SCHEMA}",\n"markups": [\n{body}\n]\n}}\n'.encode())


def _format_markups(markups: Markups, style: CurveStyle) -> str:
    head = {
        "type": markups.kind,
        "name": markups.name,
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": style.locked,
        "fixedNumberOfControlPoints": style.locked,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": len(markups.points),
    }
    descriptions = markups.descriptions or ("",) * len(markups.points)
    points = [
        {
            "id": str(n),
            "label": label,
            "description": description,
            "associatedNodeID": "",
            "position": (position + 0.0).tolist(),
            "orientation": [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0],  # of Slicer's own RAS axes
            "selected": True,
            "locked": style.locked,
            "visibility": True,
            "positionStatus": "defined",
        }
        for n, (label, position, description) in enumerate(
            zip(markups.labels, markups.points, descriptions, strict=True), start=1
        )
    ]
    listed = ",\n".join(_to_json(point) for point in points)
    display = {
        "color": [*style.colour],
        "selectedColor": [*style.colour],  # every point is selected, and this is what shows
        "activeColor": [*style.colour],
        "propertiesLabelVisibility": False,
        "pointLabelsVisibility": not style.locked,
        "textScale": 3.0,
        "glyphType": "Sphere3D",
        "glyphSize": style.thickness,
        "useGlyphScale": False,
        "lineThickness": 1.0,  # relative to glyphSize
    }
    return f'{_to_json(head)[:-1]}, "controlPoints": [\n{listed}\n], "display": {_to_json(display)}}}'


_to_json = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
