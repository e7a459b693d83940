"""Parse the table of insertions: from cells to rows, with the faults of each row."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import scipy

from needlefit.arrays import Floats
from needlefit.datasets.columns import (
    BEVEL_COLUMNS,
    BOUNDARIES_COLUMN,
    CURVATURE_COLUMNS,
    DIRECTION_COLUMNS,
    ENTRY_COLUMNS,
    HOLE_COLUMN,
    ID_PATTERN,
    MIN_SENSOR_MM,
    NEEDLE_COLUMN,
    NO_BOUNDARY,
    NUMBER_COLUMNS,
    OBSERVED_COLUMN,
    POSE_COLUMNS,
    POSE_SOURCES,
    REQUIRED_COLUMNS,
    ROLL_COLUMNS,
    SCAN_COLUMNS,
    SCAN_ROTATION_COLUMNS,
    SCAN_SHIFT_COLUMNS,
    SHARED_COLUMN,
    TURN_COLUMNS,
    InsertionRow,
    describe_column,
)
from needlefit.datasets.faults import Fault
from needlefit.datasets.formats.csv import CsvTable, note_missing_columns, parse_numbers, rename_columns
from needlefit.datasets.needles import find_unknown_needle
from needlefit.geometry.frames import Frame
from needlefit.schemas.dataset import DatasetRecord, boundaries_fault, list_needles, needle_key
from needlefit.schemas.limits import MAX_LAYERS
from needlefit.schemas.names import EXPECTED_NAME, name_fault

UNIT_VECTOR_TOLERANCE = 1e-3  # greatest deviation of a direction's length from 1
MIN_DEPTH_MM = 1.0  # an insertion of less than this, mm, was written in metres


def parse_rows(table: CsvTable, record: DatasetRecord, found: list[Fault]) -> list[InsertionRow]:
    """Return the rows without faults; note the faults of the others."""
    pose_known = record.frame.pose == "known"
    named = rename_columns(table, record.insertions.columns, record.insertions.constants, found)
    has_scan = any(column in named.cells for column in SCAN_COLUMNS)
    wanted = (*REQUIRED_COLUMNS, *(POSE_COLUMNS if pose_known else ()), *(SCAN_COLUMNS if has_scan else ()))
    if note_missing_columns(named, wanted, found):
        return []
    cell_faults: list[Fault] = []
    rows = _make_rows(named, pose_known, cell_faults)
    unread = {fault.where for fault in cell_faults}
    faults = list(_find_duplicates(named))
    for n, row in enumerate(rows):
        if named.where(n) not in unread and _is_finite(row):
            faults += _find_row_faults(row, named.where(n), record)
    found += [*cell_faults, *faults]
    bad = unread | {fault.where for fault in faults}
    return [row for n, row in enumerate(rows) if named.where(n) not in bad and _is_finite(row)]


MAX_CURVATURE = 0.1  # of a needle, 1/mm: a radius of 10 mm


def add_turns(rows: Sequence[InsertionRow], table: CsvTable, found: list[Fault]) -> list[InsertionRow]:
    """Return the rows with the turns of the bevel that a table lists; note the faults of that table."""
    turns: dict[str, list[tuple[float, float]]] = {}
    for row, (depth, roll), where in _iterate_beside(rows, table, TURN_COLUMNS, found):
        own = turns.setdefault(row.id, [])
        if not (own[-1][0] if own else 0.0) < depth < row.depth:
            what = f"turns {row.id} at {depth:g} mm"
            expected = f"depths that increase between 0 and {row.depth:g} mm"
            found.append(Fault(where, what, expected, "correct depth_mm, or remove the line"))
        own.append((depth, math.radians(roll)))
    return [replace(row, turns=tuple(turns.get(row.id, ()))) for row in rows]


def add_curvature(rows: Sequence[InsertionRow], table: CsvTable, found: list[Fault]) -> list[InsertionRow]:
    """Return the rows with the curvatures that a table lists; note the faults of that table."""
    curvature: dict[str, list[list[float]]] = {}
    for row, values, where in _iterate_beside(rows, table, CURVATURE_COLUMNS, found):
        (s, y, z, sd), own = values, curvature.setdefault(row.id, [])
        if not MIN_SENSOR_MM <= s <= row.depth - MIN_SENSOR_MM:
            expected = f"{MIN_SENSOR_MM:g} to {row.depth - MIN_SENSOR_MM:g} mm from the tip"
            fix = "correct s_mm: from the tip, inside the tissue"
            found.append(Fault(where, f"has a sensor at {s:g} mm", expected, fix))
        elif not sd > 0:
            fix = "state the standard deviation of the curvature, 1/mm"
            found.append(Fault(where, f"has sd_1_per_mm {sd:g}", "a number above 0", fix))
        elif max(abs(y), abs(z)) > MAX_CURVATURE:
            what, expected = f"has a curvature of {max(abs(y), abs(z)):g} 1/mm", f"at most {MAX_CURVATURE:g}"
            found.append(Fault(where, what, expected, "state it in 1/mm: divide 1/m by 1000"))
        elif s in (one[0] for one in own):
            what = f"states the curvature of {row.id} at {s:g} mm again"
            found.append(Fault(where, what, "one line for each sensor", "remove the line"))
        own.append(values)
    read = {name: np.array(values) for name, values in curvature.items()}
    return [replace(row, curvature=read.get(row.id)) for row in rows]


def _iterate_beside(
    rows: Sequence[InsertionRow], table: CsvTable, columns: Sequence[str], found: list[Fault]
) -> Iterator[tuple[InsertionRow, list[float], str]]:
    """Yield the row, the numbers and the place of each line of a table of an id and numbers; note faults."""
    if note_missing_columns(table, columns, found):
        return
    known = {row.id: row for row in rows}
    values = np.column_stack([parse_numbers(table, name, found) for name in columns[1:]]).tolist()
    for n, name in enumerate(table.cells[columns[0]]):
        if name in known:
            yield known[name], values[n], table.where(n)
        else:
            fix = "correct the id, or remove the line"
            found.append(Fault(table.where(n), f"is of insertion {name!r:.60}", "an id of the table", fix))


def _is_finite(row: InsertionRow) -> bool:
    """Say whether every number that a row must have could be read; where not, a fault is noted."""
    pose = [] if row.entry is None or row.direction is None else [*row.entry, *row.direction]
    return bool(np.isfinite([row.depth, *pose]).all())


def _make_rows(table: CsvTable, pose_known: bool, found: list[Fault]) -> list[InsertionRow]:
    """Turn cells into rows; a faulty number leaves a NaN and a note."""

    def column(name: str, default: float | None = None) -> Floats:
        fill = math.nan if default is None else default
        if name not in table.cells:
            return np.full(len(table.lines), fill)
        values = parse_numbers(table, name, found, optional=default is not None or name in BEVEL_COLUMNS)
        return np.where(np.isnan(values), fill, values)

    def vectors(names: tuple[str, ...], default: float | None = None) -> Floats:
        return np.column_stack([column(name, default) for name in names])

    def texts(name: str) -> list[str]:
        return list(table.cells[name]) if name in table.cells else [""] * len(table.lines)

    layers, alternative = column("layers"), column("layers_alternative", math.nan)
    bevel = vectors(BEVEL_COLUMNS)
    turn, shift = vectors(SCAN_ROTATION_COLUMNS, math.nan), vectors(SCAN_SHIFT_COLUMNS, math.nan)
    entry, direction = (vectors(ENTRY_COLUMNS), vectors(DIRECTION_COLUMNS)) if pose_known else (None, None)
    numbers = {}
    for name, (field, default) in NUMBER_COLUMNS.items():
        values = column(name, default)
        values = np.radians(values) if name.endswith("_deg") else values
        numbers[field] = [None if math.isnan(x) and default is not None else x for x in values.tolist()]
    boundaries = [_parse_boundaries(table, n, found) for n in range(len(table.lines))]
    needles, observed = texts(NEEDLE_COLUMN), texts(OBSERVED_COLUMN)
    side, ids, holes = column("bevel_side", 1.0), texts("id"), texts(HOLE_COLUMN)
    rolls, sides = texts(ROLL_COLUMNS[0]), texts("bevel_side")
    for n, both in enumerate(zip(rolls, sides, strict=True) if any(rolls) else ()):
        if all(both) or not any(both):
            what = f"states bevel_side {both[1]!r:.20} and bevel_roll_deg {both[0]!r:.20}"
            found.append(Fault(table.where(n), what, "one of the two, 0 too", "fill one of the two cells"))
    sources = texts("pose_source") if pose_known else ["none"] * len(ids)
    return [
        InsertionRow(
            id=ids[n],
            medium=medium,
            specimen=specimen or holes[n] or ids[n],
            layers=_to_int(layers[n]),
            layers_alternative=_to_int(layers[n] if np.isnan(alternative[n]) else alternative[n]),
            side=_to_int(side[n]),
            entry=None if entry is None else entry[n],
            direction=None if direction is None else direction[n],
            bevel=None if np.isnan(bevel[n]).all() else bevel[n],
            pose_source=sources[n],  # type: ignore[arg-type]  # checked with the row
            patient=_make_patient_frame(turn[n], shift[n]),
            needle=needles[n],
            boundaries=boundaries[n],
            hole=holes[n],
            observed=observed[n],
            line=int(table.lines[n]),
            **{field: values[n] for field, values in numbers.items()},  # type: ignore[arg-type]
        )
        for n, (medium, specimen) in enumerate(zip(texts("medium"), texts("specimen"), strict=True))
    ]


def _parse_boundaries(table: CsvTable, row: int, found: list[Fault]) -> tuple[float, ...] | None:
    """Return the depths of an insertion's own boundaries, mm; None of an empty cell, or after a fault."""
    text = table.cells[BOUNDARIES_COLUMN].iloc[row] if BOUNDARIES_COLUMN in table.cells else ""
    if text in ("", NO_BOUNDARY):
        return None if text == "" else ()
    numbers = pd.to_numeric(pd.Series(text.split(";")), errors="coerce")
    depths = tuple(numbers.astype(float).tolist())
    if not np.isfinite(depths).all():
        fault = f"is {text!r:.60}"
    elif len(depths) >= MAX_LAYERS:
        fault = f"has {len(depths)} depths, more than {MAX_LAYERS - 1}"
    elif not (fault := boundaries_fault(depths)):
        return depths
    expected = f"depths from the entry on, mm, such as 18;36, or {NO_BOUNDARY}"
    fix = "correct the cell, or leave it empty: the boundaries of the medium"
    what = f"{describe_column(table.names, BOUNDARIES_COLUMN)} {fault}"
    found.append(Fault(table.where(row), what, expected, fix))
    return None


def _make_patient_frame(turn: Floats, shift: Floats) -> Frame | None:
    """Return a scan's frame in the world, None where all six cells are empty; NaN where only some are."""
    six = np.concatenate([turn, shift])
    if np.isnan(six).all():
        return None
    if np.isnan(six).any():
        return Frame(np.full(3, np.nan), np.full((3, 3), np.nan))
    return Frame(shift, scipy.spatial.transform.Rotation.from_rotvec(turn, degrees=True).as_matrix())


def _to_int(value: float) -> int:
    """Return a whole number as int, 0 (which no column allows) for anything else."""
    return int(value) if np.isfinite(value) and value == round(value) else 0


def _find_row_faults(row: InsertionRow, where: str, record: DatasetRecord) -> Iterator[Fault]:
    """Say what is wrong with one row; numbers that could not be read were noted before."""
    if not ID_PATTERN.fullmatch(row.id):
        expected = "at most 100 letters, digits, `.`, `_`, `-`: it names a file"
        yield Fault(where, f"id is {row.id!r}", expected, "rename it, and its centreline with it")
    for name, value in (("specimen", row.specimen), (HOLE_COLUMN, row.hole)):
        if (value or name == "specimen") and (fault := name_fault(value)):
            yield Fault(where, f"{name} is {value!r}: {fault}", EXPECTED_NAME, "rename it")
    if row.medium not in record.media:
        listed = ", ".join(record.media) or "(none)"
        fix = "correct it, or add a table [media.NAME] to dataset.toml"
        yield Fault(where, f"medium {row.medium!r} is unknown", f"one of {listed}", fix)
    yield from _find_boundaries_fault(row, where, record)
    if row.layers < 1 or (row.layers_alternative or 0) < 1:
        what = "layers or layers_alternative is not a count"
        yield Fault(where, what, "a whole number from 1", "count the layers that the needle went through")
    if row.side not in (1, -1):
        what = "bevel_side is unknown"
        yield Fault(where, what, "+1 (toward +y of C) or -1", "write 1 or -1, or leave the cell empty: +1")
    if row.roll is not None and record.frame.pose == "free":
        what = "a roll is stated for a shape of unknown pose"
        yield Fault(where, what, "no bevel_roll_deg", 'remove it, or state poses (pose = "known")')
    elif row.roll is not None and row.bevel is None:
        fix = f"fill {', '.join(BEVEL_COLUMNS)}: the direction of a roll of 0"
        yield Fault(where, "bevel_roll_deg is stated without its direction of 0", "a direction", fix)
    for name, (field, default) in NUMBER_COLUMNS.items():
        if "_sd_" in name and default is not None and (getattr(row, field) or 0.0) < 0:
            expected = "a standard deviation, 0 or more"
            fix = "remove the sign, or leave the cell empty"
            fix += "" if math.isnan(default) else f": {default:g}"
            yield Fault(where, f"{name} is negative", expected, fix)
    if row.boundary_shared_sd is not None and row.boundary_shared_sd > row.boundary_sd:
        what = f"{SHARED_COLUMN} is {row.boundary_shared_sd:g}, more than boundary_sd_mm, {row.boundary_sd:g}"
        expected = "the part of boundary_sd_mm that all insertions into the specimen share"
        yield Fault(where, what, expected, "correct one of them, or leave the cell empty")
    yield from _find_depth_faults(row, where, record)
    yield from _find_pose_faults(row, where, record)


def _find_boundaries_fault(row: InsertionRow, where: str, record: DatasetRecord) -> Iterator[Fault]:
    medium = record.media.get(row.medium)
    if row.boundaries is None or medium is None or not medium.surfaces:
        return
    column = describe_column(record.insertions.columns, BOUNDARIES_COLUMN)
    what = f"{column} is stated, and medium {row.medium} has surfaces"
    fix = f"leave the cell empty, or remove media.{row.medium}.surfaces in dataset.toml"
    yield Fault(where, what, "either surfaces or depths of the boundaries", fix)


def _find_depth_faults(row: InsertionRow, where: str, record: DatasetRecord) -> Iterator[Fault]:
    needles = list_needles(record)
    if row.needle not in needles:
        yield from find_unknown_needle(row.needle, where, record)
        return
    length, guide = needles[row.needle].length_mm, row.guide_distance
    depth_mm = describe_column(record.insertions.columns, "depth_mm")
    if row.depth <= 0:
        fix = "give the length from the entry to the tip, without a sign"
        yield Fault(where, f"{depth_mm} is {row.depth:g}", "an inserted length above 0", fix)
    elif row.depth < MIN_DEPTH_MM:
        what = f"{depth_mm} is {row.depth:g}: this looks like metres"
        yield Fault(where, what, "millimetres", "multiply the column by 1000")
    if row.depth >= length:
        what = f"{depth_mm} is {row.depth:g}, but the needle is only {length:g} mm long"
        expected = "a depth smaller than the needle's length, both in mm"
        key = f"{needle_key(row.needle)}.length_mm"
        yield Fault(where, what, expected, f"correct {key} in dataset.toml, or {depth_mm}")
    if guide is not None and not 0 < guide <= length - row.depth:
        what = f"guide_distance_mm is {guide:g} at depth {row.depth:g} mm of a {length:g} mm needle"
        expected = "above 0, and within the needle outside the tissue"
        yield Fault(where, what, expected, "correct it, or leave the cell empty: held at its base")


def _find_pose_faults(row: InsertionRow, where: str, record: DatasetRecord) -> Iterator[Fault]:
    if row.bevel is not None and (np.isnan(row.bevel).any() or not np.linalg.norm(row.bevel) > 0):
        what = f"{', '.join(BEVEL_COLUMNS)} are {row.bevel.tolist()}"
        yield Fault(where, what, "a direction, or three empty cells", "fill all three, or none")
    if row.patient is not None and np.isnan(row.patient.origin).any():
        expected = "six numbers, or six empty cells: as [frame] lps_to_world states"
        what = f"{SCAN_COLUMNS[0]} ... {SCAN_COLUMNS[-1]} are filled in part"
        yield Fault(where, what, expected, "fill all six, or none")
    if record.frame.pose == "free" or row.direction is None:
        return
    if row.pose_source not in POSE_SOURCES[:-1]:
        expected = f"one of {', '.join(POSE_SOURCES[:-1])}"
        fix = 'state where the entry pose comes from; where there is none, frame.pose is "free"'
        yield Fault(where, f"pose_source is {row.pose_source!r}", expected, fix)
    length = float(np.linalg.norm(row.direction))
    if abs(length - 1) > UNIT_VECTOR_TOLERANCE:
        fix = "divide the three numbers by their length" if length else "give the direction of insertion"
        yield Fault(
            where, f"entry direction has length {length:.4g}", "a unit vector (entry_dx, _dy, _dz)", fix
        )


def _find_duplicates(table: CsvTable) -> Iterator[Fault]:
    """Yield ids that stand there twice, and specimens that differ by case alone."""
    first: dict[str, int] = {}
    for n, name in enumerate(table.cells["id"]):
        if name.casefold() in first:
            what = f"id {name!r} stands on line {first[name.casefold()]} already"
            fix = "rename one of the two, and its centreline with it, or remove the row that is there twice"
            yield Fault(table.where(n), what, "a different id for every insertion", fix)
        first.setdefault(name.casefold(), int(table.lines[n]))
    spelled: dict[str, str] = {}
    for n, name in enumerate(table.cells.get("specimen", ())):
        if (other := spelled.setdefault(name.casefold(), name)) != name:
            fix = "write both alike, or give them names that differ"
            yield Fault(table.where(n), f"specimen is {name!r}, and {other!r} above", "one spelling", fix)
