"""Parse the table of insertions: from cells to rows, with the faults of each row."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

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
    EXPECTED_ID,
    HOLE_COLUMN,
    MIN_SENSOR_MM,
    NO_BOUNDARY,
    NUMBER_COLUMNS,
    OBSERVATION_PREFIX,
    POSE_COLUMNS,
    REQUIRED_COLUMNS,
    ROLL_COLUMNS,
    SCAN_COLUMNS,
    SHARED_COLUMN,
    STATED_POSE_SOURCES,
    TEXT_COLUMNS,
    TURN_COLUMNS,
    InsertionRow,
    describe_column,
    is_id,
)
from needlefit.datasets.faults import Fault, note_fault
from needlefit.datasets.formats.csv import CsvTable, note_missing_columns, parse_numbers, rename_columns
from needlefit.datasets.needles import find_unknown_needle
from needlefit.geometry.frames import UNIT_VECTOR_TOLERANCE, Frame
from needlefit.mechanics.needle import Needle
from needlefit.project.unit_warnings import MIN_DEPTH_MM
from needlefit.schemas.dataset import DatasetRecord, boundaries_fault, needle_key
from needlefit.schemas.limits import MAX_LAYERS
from needlefit.schemas.names import EXPECTED_NAME, name_fault

Problem = tuple[str, str, str]  # of a row: what is wrong, what is expected, and how it is fixed


def parse_rows(table: CsvTable, record: DatasetRecord, all_faults: list[Fault]) -> list[InsertionRow]:
    """Return the rows without faults; note the faults of the others."""
    pose_known = record.frame.pose == "known"
    named = rename_columns(table, record.insertions.columns, record.insertions.constants, all_faults)
    has_scan = any(column in named.cells for column in SCAN_COLUMNS)
    wanted = (*REQUIRED_COLUMNS, *(POSE_COLUMNS if pose_known else ()), *(SCAN_COLUMNS if has_scan else ()))
    if note_missing_columns(named, wanted, all_faults):
        return []
    cell_faults, faults = list[Fault](), list[Fault]()
    rows = _make_rows(named, pose_known, cell_faults)
    if record.insertions.constants.keys() >= {*ENTRY_COLUMNS}:
        # one entry of all rows is the origin of their coordinates, and no hole
        rows = [replace(row, hole=row.hole or row.id) for row in rows]
    unread = {fault.where for fault in cell_faults}
    _note_duplicates(named, faults)
    for n, row in enumerate(rows):
        if named.where(n) not in unread and _is_finite(row):
            for problem in _find_row_faults(row, record):
                note_fault(faults, named.where(n), *problem)
    all_faults += [*cell_faults, *faults]
    bad = unread | {fault.where for fault in faults}
    return [row for n, row in enumerate(rows) if named.where(n) not in bad and _is_finite(row)]


MAX_CURVATURE = 0.1  # largest curvature of a needle (1/mm): a radius of 10 mm


def add_turns(rows: Sequence[InsertionRow], table: CsvTable, faults: list[Fault]) -> list[InsertionRow]:
    """Return the rows with the turns of the bevel that a table lists; note the faults of that table."""
    turns: dict[str, list[tuple[float, float]]] = {}
    for row, (depth, roll), where in _iterate_beside(rows, table, TURN_COLUMNS, faults):
        turns_of_row = turns.setdefault(row.id, [])
        if not (turns_of_row[-1][0] if turns_of_row else 0.0) < depth < row.depth:
            note_fault(
                faults,
                where,
                f"turns {row.id} at {depth:g} mm",
                f"depths that increase between 0 and {row.depth:g} mm",
                "correct depth_mm, or remove the line",
            )
        turns_of_row.append((depth, math.radians(roll)))
    return [replace(row, turns=tuple(turns.get(row.id, ()))) for row in rows]


def add_curvature(
    rows: Sequence[InsertionRow], table: CsvTable, faults: list[Fault], needles: Mapping[str, Needle]
) -> list[InsertionRow]:
    """Return the rows with the curvatures that a table lists; note the faults of that table.

    Sensors lie between tip and base of the needle, which has a name in `needles`.
    """
    curvature: dict[str, list[list[float]]] = {}
    for row, values, where in _iterate_beside(rows, table, CURVATURE_COLUMNS, faults):
        (s, y, z, sd), sensors = values, curvature.setdefault(row.id, [])
        farthest = needles[row.needle].length - MIN_SENSOR_MM
        if not MIN_SENSOR_MM <= s <= farthest:
            note_fault(
                faults,
                where,
                f"has a sensor at {s:g} mm",
                f"{MIN_SENSOR_MM:g} to {farthest:g} mm from the tip",
                "correct s_mm: from the tip, on the needle",
            )
        elif not sd > 0:
            note_fault(
                faults,
                where,
                f"has sd_1_per_mm {sd:g}",
                "a number above 0",
                "state the standard deviation of the curvature, 1/mm",
            )
        elif max(abs(y), abs(z)) > MAX_CURVATURE:
            note_fault(
                faults,
                where,
                f"has a curvature of {max(abs(y), abs(z)):g} 1/mm",
                f"at most {MAX_CURVATURE:g}",
                "state it in 1/mm: divide 1/m by 1000",
            )
        elif s in (sensor[0] for sensor in sensors):
            note_fault(
                faults,
                where,
                f"states the curvature of {row.id} at {s:g} mm again",
                "one line for each sensor",
                "remove the line",
            )
        sensors.append(values)
    read = {name: np.array(values) for name, values in curvature.items()}
    return [replace(row, curvature=read.get(row.id)) for row in rows]


def _iterate_beside(
    rows: Sequence[InsertionRow], table: CsvTable, columns: Sequence[str], faults: list[Fault]
) -> Iterator[tuple[InsertionRow, list[float], str]]:
    """Yield the row, the numbers and the place of each line of a table of an id and numbers; note faults."""
    if note_missing_columns(table, columns, faults):
        return
    rows_by_id = {row.id: row for row in rows}
    values = np.column_stack([parse_numbers(table, name, faults) for name in columns[1:]]).tolist()
    for n, name in enumerate(table.cells[columns[0]]):
        if name in rows_by_id:
            yield rows_by_id[name], values[n], table.where(n)
        else:
            note_fault(
                faults,
                table.where(n),
                f"is of insertion {name!r:.60}",
                "an id of the table",
                "correct the id, or remove the line",
            )


def _is_finite(row: InsertionRow) -> bool:
    """Say whether every number that a row must have could be read; where not, a fault is noted."""
    pose = [] if row.entry is None or row.direction is None else [*row.entry, *row.direction]
    return bool(np.isfinite([row.depth, *pose]).all())


def _make_rows(table: CsvTable, pose_known: bool, faults: list[Fault]) -> list[InsertionRow]:
    """Turn cells into rows; a faulty number leaves a NaN and a note."""

    def numbers(name: str, default: float | None = None) -> Floats:
        return parse_numbers(table, name, faults, default)

    def vectors(names: tuple[str, ...], default: float | None = None) -> Floats:
        return np.column_stack([numbers(name, default) for name in names])

    def texts(name: str) -> list[str]:
        return [*table.cells.get(name, [""] * len(table.lines))]

    count, layers, alternative = (
        range(len(table.lines)),
        numbers("layers"),
        numbers("layers_alternative", math.nan),
    )
    fields: dict[str, Iterable[Any]] = {name: texts(name) for name in TEXT_COLUMNS} | {
        "layers": map(_to_int, layers),
        "layers_alternative": map(_to_int, np.where(np.isnan(alternative), layers, alternative)),
        "bevel": [
            None if np.isnan(direction).all() else direction for direction in vectors(BEVEL_COLUMNS, math.nan)
        ],
        "patient": map(_make_patient_frame, vectors(SCAN_COLUMNS, math.nan)),
        "line": table.lines.tolist(),
    }
    if pose_known:
        fields |= {"entry": vectors(ENTRY_COLUMNS), "direction": vectors(DIRECTION_COLUMNS)}
    else:
        fields["pose_source"] = ["none" for _ in count]
    for name, (field, default) in NUMBER_COLUMNS.items():
        values = numbers(name, default)
        values = np.radians(values) if name.endswith("_deg") else values
        fields[field] = [None if math.isnan(x) and default is not None else x for x in values.tolist()]
    observed = {
        name.removeprefix(OBSERVATION_PREFIX): numbers(name, math.nan).tolist()
        for name in map(str, table.cells)
        if name.startswith(OBSERVATION_PREFIX)
    }
    fields["observation_values"] = [
        {name: values[n] for name, values in observed.items() if not math.isnan(values[n])} for n in count
    ]
    fields["boundaries"] = [_parse_boundaries(table, n, faults) for n in count]
    fields["side"] = map(_to_int, numbers("bevel_side", 1.0))
    names = zip(*(texts(name) for name in ("specimen", HOLE_COLUMN, "id")), strict=True)
    fields["specimen"] = [next(filter(None, specimen_names), "") for specimen_names in names]
    rolls, sides = texts(ROLL_COLUMNS[0]), texts("bevel_side")
    for n, both in enumerate(zip(rolls, sides, strict=True) if any(rolls) else ()):
        if all(both) or not any(both):
            note_fault(
                faults,
                table.where(n),
                f"states bevel_side {both[1]!r:.20} and bevel_roll_deg {both[0]!r:.20}",
                "one of the two, 0 too",
                "fill one of the two cells",
            )
    rows = zip(*fields.values(), strict=True)
    return [InsertionRow(**dict(zip(fields, values, strict=True))) for values in rows]


def _parse_boundaries(table: CsvTable, row: int, faults: list[Fault]) -> tuple[float, ...] | None:
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
    note_fault(
        faults,
        table.where(row),
        f"{describe_column(table.names, BOUNDARIES_COLUMN)} {fault}",
        f"depths from the entry on, mm, such as 18;36, or {NO_BOUNDARY}",
        "correct the cell, or leave it empty: the boundaries of the medium",
    )
    return None


def _make_patient_frame(motion: Floats) -> Frame | None:
    """Return a scan's frame in the world, None where all six cells are empty; NaN where only some are."""
    if np.isnan(motion).all():
        return None
    if np.isnan(motion).any():
        return Frame(np.full(3, np.nan), np.full((3, 3), np.nan))
    return Frame(
        motion[3:], scipy.spatial.transform.Rotation.from_rotvec(motion[:3], degrees=True).as_matrix()
    )


def _to_int(value: float) -> int:
    """Return a whole number as int, 0 (which no column allows) for anything else."""
    return int(value) if np.isfinite(value) and value == round(value) else 0


def _find_row_faults(row: InsertionRow, record: DatasetRecord) -> Iterator[Problem]:
    """Say what is wrong with one row; numbers that could not be read were noted before."""
    if not is_id(row.id):
        yield f"id is {row.id!r}", EXPECTED_ID, "rename it, and its centreline with it"
    for name, value in (("specimen", row.specimen), (HOLE_COLUMN, row.hole)):
        if (value or name == "specimen") and (fault := name_fault(value)):
            yield f"{name} is {value!r}: {fault}", EXPECTED_NAME, "rename it"
    if row.medium not in record.media:
        listed = ", ".join(record.media) or "(none)"
        yield (
            f"medium {row.medium!r} is unknown",
            f"one of {listed}",
            "correct it, or add a table [media.NAME] to dataset.toml",
        )
    yield from _find_boundaries_fault(row, record)
    if row.layers < 1 or (row.layers_alternative or 0) < 1:
        yield (
            "layers or layers_alternative is not a count",
            "a whole number from 1",
            "count the layers that the needle went through",
        )
    if row.side not in (1, -1):
        yield (
            "bevel_side is unknown",
            "+1 (toward +y of C) or -1",
            "write 1 or -1, or leave the cell empty: +1",
        )
    if row.roll is not None and record.frame.pose == "free":
        yield (
            "a roll is stated for a shape of unknown pose",
            "no bevel_roll_deg",
            'remove it, or state poses (pose = "known")',
        )
    elif row.roll is not None and row.bevel is None:
        yield (
            "bevel_roll_deg is stated without its direction of 0",
            "a direction",
            f"fill {', '.join(BEVEL_COLUMNS)}: the direction of a roll of 0",
        )
    for name, (field, default) in NUMBER_COLUMNS.items():
        if "_sd_" in name and default is not None and (getattr(row, field) or 0.0) < 0:
            fix = "remove the sign, or leave the cell empty"
            fix += "" if math.isnan(default) else f": {default:g}"
            yield f"{name} is negative", "a standard deviation, 0 or more", fix
    if row.boundary_shared_sd is not None and row.boundary_shared_sd > row.boundary_sd:
        yield (
            f"{SHARED_COLUMN} is {row.boundary_shared_sd:g}, more than boundary_sd_mm, {row.boundary_sd:g}",
            "a part of boundary_sd_mm",
            "correct one of them, or leave the cell empty",
        )
    yield from _find_depth_faults(row, record)
    yield from _find_pose_faults(row, record)


def _find_boundaries_fault(row: InsertionRow, record: DatasetRecord) -> Iterator[Problem]:
    medium = record.media.get(row.medium)
    if row.boundaries is None or medium is None or not medium.surfaces:
        return
    column = describe_column(record.insertions.columns, BOUNDARIES_COLUMN)
    yield (
        f"{column} is stated, and medium {row.medium} has surfaces",
        "either surfaces or depths of the boundaries",
        f"leave the cell empty, or remove media.{row.medium}.surfaces in dataset.toml",
    )


def _find_depth_faults(row: InsertionRow, record: DatasetRecord) -> Iterator[Problem]:
    needles = record.all_needles
    if row.needle not in needles:
        yield from (
            (fault.what, fault.expected, fault.fix) for fault in find_unknown_needle(row.needle, "", record)
        )
        return
    length, guide = needles[row.needle].length_mm, row.guide_distance
    depth_mm = describe_column(record.insertions.columns, "depth_mm")
    if row.depth <= 0:
        yield (
            f"{depth_mm} is {row.depth:g}",
            "an inserted length above 0",
            "give the length from the entry to the tip",
        )
    elif row.depth < MIN_DEPTH_MM:
        yield (
            f"{depth_mm} is {row.depth:g}: this looks like metres",
            "millimetres",
            "multiply the column by 1000",
        )
    if row.depth >= length:
        key = f"{needle_key(row.needle)}.length_mm"
        yield (
            f"{depth_mm} is {row.depth:g}, but the needle is only {length:g} mm long",
            "a depth smaller than the needle's length, both in mm",
            f"correct {key} in dataset.toml, or {depth_mm}",
        )
    if guide is not None and not 0 < guide <= length - row.depth:
        yield (
            f"guide_distance_mm is {guide:g} at depth {row.depth:g} mm of a {length:g} mm needle",
            "above 0, and within the needle outside the tissue",
            "correct it, or leave the cell empty: held at its base",
        )


def _find_pose_faults(row: InsertionRow, record: DatasetRecord) -> Iterator[Problem]:
    if row.bevel is not None and (np.isnan(row.bevel).any() or not np.linalg.norm(row.bevel) > 0):
        yield (
            f"{', '.join(BEVEL_COLUMNS)} are {row.bevel.tolist()}",
            "a direction, or three empty cells",
            "fill all three, or none",
        )
    if row.patient is not None and np.isnan(row.patient.origin).any():
        yield (
            f"{SCAN_COLUMNS[0]} ... {SCAN_COLUMNS[-1]} are filled in part",
            "six numbers, or six empty cells",
            "fill all six, or none",
        )
    if record.frame.pose == "free" or row.direction is None:
        return
    if row.pose_source not in STATED_POSE_SOURCES:
        yield (
            f"pose_source is {row.pose_source!r}",
            f"one of {', '.join(STATED_POSE_SOURCES)}",
            'correct it; without an entry pose: frame.pose = "free"',
        )
    length = float(np.linalg.norm(row.direction))
    if abs(length - 1) > UNIT_VECTOR_TOLERANCE:
        fix = "divide the three numbers by their length" if length else "give the direction of insertion"
        yield f"entry direction has length {length:.4g}", "a unit vector (entry_dx, _dy, _dz)", fix


def _note_duplicates(table: CsvTable, faults: list[Fault]) -> None:
    """Note ids that stand there twice, and specimens that differ by case alone."""
    first: dict[str, int] = {}
    for n, name in enumerate(table.cells["id"]):
        if (line := first.setdefault(name.casefold(), int(table.lines[n]))) != table.lines[n]:
            note_fault(
                faults,
                table.where(n),
                f"id {name!r} stands on line {line} already",
                "a different id for every insertion",
                "rename one, and its centreline with it, or remove it",
            )
    spelled: dict[str, str] = {}
    for n, name in enumerate(table.cells.get("specimen", ())):
        if (other := spelled.setdefault(name.casefold(), name)) != name:
            note_fault(
                faults,
                table.where(n),
                f"specimen is {name!r}, and {other!r} above",
                "one spelling",
                "write both alike, or give them names that differ",
            )
