"""Read and write `.mrk.json`, the markup files of 3D Slicer (schema 1.0.x); only curves are written."""

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.datasets.markups import (
    EXPECTED_SYSTEM,
    Markups,
    make_markups_format,
    parse_position,
    parse_system,
    require_points,
)
from needlefit.errors import DataError
from needlefit.geometry.frames import to_lps
from needlefit.project.input_files import read_json

# What Slicer itself writes: an identifier, no address.
SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
UNITS_MM = {"mm": 1.0, "um": 1e-3, "cm": 10.0, "m": 1e3}  # UCUM codes of length, in mm
SET_STATES, UNSET_STATES = ("defined",), ("undefined", "preview", "missing")  # states of a point
SAVE_AGAIN_FIX = "save the list again in Slicer, as Markups JSON"

_SCHEMA = re.compile(r"markups-schema-v1\.\d+\.\d+\.json#*$", re.IGNORECASE)


@dataclass(frozen=True)
class CurveStyle:
    """How 3D Slicer shows a list: colour (red, green, blue; 0 to 1), thickness of its line, mm."""

    colour: tuple[float, float, float]
    thickness: float = 0.5
    locked: bool = True  # whether its points cannot be moved; their labels are shown where they can


def read_mrk_json(path: Path) -> tuple[Markups, ...]:
    """Read every list of points of a `.mrk.json` file; planes and boxes (ROI) are skipped.

    DataError if the file is missing, no markups file, or holds no list of points; if a list is empty, does
    not say its coordinate system, or has a point that is not finite.
    """
    whole = read_json(path)
    lists = whole.get("markups") if isinstance(whole, dict) else None
    if not isinstance(lists, list) or not all(isinstance(one, dict) for one in lists):
        expected = '{"@schema": ..., "markups": [{"type": "Curve", ...}]}'
        raise DataError("has no `markups`", where=str(path), expected=expected, fix=SAVE_AGAIN_FIX)
    schema = str(whole.get("@schema", SCHEMA))
    if not _SCHEMA.search(schema):
        what, expected = f"its schema is {schema[:120]!r}", "markups-schema-v1.x.y.json"
        raise DataError(what, where=str(path), expected=expected, fix=SAVE_AGAIN_FIX)
    found = [
        _parse_markups(path, one, n)
        for n, one in enumerate(lists, 1)
        if one.get("type") not in ("Plane", "ROI")
    ]
    if not found:
        kinds = ", ".join(str(one.get("type")) for one in lists) or "nothing"
        what, expected = f"holds no list of points, but {kinds}", "a point list, a Curve or a Line"
        raise DataError(what, where=str(path), expected=expected, fix="save such a list in Slicer")
    return tuple(found)


def write_mrk_json(path: Path, lists: Iterable[tuple[Markups, CurveStyle]]) -> None:
    """Write lists to one file that Slicer opens as one node each: LPS, mm, all digits.

    The same lists give the same bytes.
    """
    texts = [_format_markups(markups, style) for markups, style in lists]
    body = ",\n".join(texts)
    path.write_bytes(f'{{\n"@schema": "{SCHEMA}",\n"markups": [\n{body}\n]\n}}\n'.encode())


def _parse_markups(path: Path, one: dict[str, Any], number: int) -> Markups:
    name = str(one.get("name") or (path.name.removesuffix(".json").removesuffix(".mrk")))
    where = f"{path}, list {number} `{name}`"
    kind = one.get("type")
    if not isinstance(kind, str):
        raise DataError("has no `type`", where=where, expected="Fiducial, Curve, ...", fix=SAVE_AGAIN_FIX)
    if one.get("coordinateSystem") in (None, ""):
        what = "does not say its coordinate system"
        fix = "add the key (Slicer writes it, and takes LPS where it is missing), or " + SAVE_AGAIN_FIX
        raise DataError(what, where=where, expected=f'"coordinateSystem": {EXPECTED_SYSTEM}', fix=fix)
    system = parse_system(str(one["coordinateSystem"]), where)
    scale = _find_scale(one.get("coordinateUnits", "mm"), where)
    points = one.get("controlPoints", [])
    if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
        raise DataError("`controlPoints` is no list of points", where=where, fix=SAVE_AGAIN_FIX)
    labels, descriptions, positions, unset = [], [], [], []
    for n, point in enumerate(points, start=1):
        label = str(point.get("label") or "")
        there = f"{where}, point {n}" + (f" ({label})" if label else "")
        status = point.get("positionStatus", "defined")
        if status not in (*SET_STATES, *UNSET_STATES):
            what = f"positionStatus is {str(status)[:80]!r}"
            expected = f"one of {', '.join((*SET_STATES, *UNSET_STATES))}"
            raise DataError(what, where=there, expected=expected, fix=SAVE_AGAIN_FIX)
        if status in SET_STATES and point.get("position") not in (None, "", []):
            labels.append(label)
            descriptions.append(str(point.get("description") or ""))
            positions.append(parse_position(point["position"], there))
        else:
            unset.append(label)
    coordinates = scale * np.array(positions, dtype=np.float64).reshape(-1, 3)
    return require_points(
        Markups(
            path,
            name,
            kind,
            tuple(labels),
            to_lps(coordinates, system),
            system,
            tuple(unset),
            descriptions=tuple(descriptions),
        )
    )


def _find_scale(units: object, where: str) -> float:
    """Return the factor to mm; units are a code, or a code with its coding scheme and meaning."""
    code = units[0] if isinstance(units, list) and units else units
    if isinstance(code, str) and code in UNITS_MM:
        return UNITS_MM[code]
    what = f"coordinateUnits is {str(units)[:80]}"
    expected = f"one of {', '.join(UNITS_MM)} (UCUM)"
    raise DataError(what, where=where, expected=expected, fix="save the list in mm")


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


def _to_json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


MRK_JSON = make_markups_format("mrk_json", (".json",), read_mrk_json)
