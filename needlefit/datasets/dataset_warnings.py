"""Warn about a dataset that can still be fitted: placeholders, copies, mistyped columns, missed surfaces."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import SequenceMatcher
from pathlib import Path

import numpy as np

from needlefit.datasets.bevel_side import classify_insertion, find_pooled_side_warnings, find_side_warnings
from needlefit.datasets.columns import (
    BASE_SHIFT_COLUMN,
    INSERTION_COLUMNS,
    POINT_COLUMNS,
    POSE_COLUMNS,
    SCAN_COLUMNS,
    SD_COLUMN,
    SHARED_COLUMN,
)
from needlefit.datasets.formats.csv import CsvTable
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.insertion_faults import ListedInsertion
from needlefit.datasets.noise import find_noise_warnings, find_stated_warnings
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.unit_warnings import FormatPlace, format_place, layer_warnings, needle_warnings
from needlefit.schemas.dataset import DatasetRecord, SourceRecord, TrackDatasetRecord

COPY_TOLERANCE_MM = 1e-6
"""Largest distance, per axis, of two points that count as the same."""


def is_copy(one: Insertion, other: Insertion) -> bool:
    """Whether two insertions have the same centreline, point by point."""
    a, b = one.centerline, other.centerline
    if (
        a.shape != b.shape or np.abs(a[-1] - b[-1]).max() > COPY_TOLERANCE_MM
    ):  # tips differ in nearly every pair
        return False
    return bool(np.abs(a - b).max() <= COPY_TOLERANCE_MM)


def find_copy_warnings(listed: Sequence[ListedInsertion]) -> Iterator[ResultWarning]:
    """Yield a warning for each insertion that is a copy of an earlier one."""
    for n, later in enumerate(listed):
        first = next((one for one in listed[:n] if is_copy(one.insertion, later.insertion)), None)
        if first is not None:
            what = f"{later.insertion.id} has the same centreline as {first.insertion.id}, point by point"
            yield ResultWarning("copy", what, later.where, "remove one of the two, or restore its own file")


PLACEHOLDER = "TO FILL IN"
"""Marks values that a template cannot know."""

_PLACEHOLDER_PATTERN = re.compile(r"to[ _-]?fill[ _-]?in", re.IGNORECASE)
_PLACEHOLDER_FIX = "write what was measured; reports print it"


def find_record_warnings(record: DatasetRecord | TrackDatasetRecord, file: Path) -> list[ResultWarning]:
    """Return the warnings about a `dataset.toml`, without regard to its tables."""
    where = format_place(file)
    found = [*find_placeholder_keys(record, where), *needle_warnings(record.needle, where)]
    if isinstance(record, DatasetRecord):
        found += find_assumption_warnings(record, where)
    return [*found, *find_stated_warnings(record.noise, record.needle.length_mm, where)]


def find_assumption_warnings(record: DatasetRecord, where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning if an import assumed values of which its files and its user stated nothing."""
    decisions = () if record.import_ is None else record.import_.decisions
    assumed = [f"{one.what} = {one.value}" for one in decisions if one.source == "assumption"]
    if assumed:
        what = f"the import assumed {'; '.join(assumed)}"
        fix = 'correct what is wrong, and write source = "confirmed" in its line of [import]'
        yield ResultWarning("assumed", what, where("import.decisions"), fix)


def find_placeholder_keys(record: SourceRecord, where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning if texts of a template were not replaced."""
    keys = list(_iterate_placeholder_keys(record.model_dump(by_alias=True)))
    if keys:
        named = ", ".join(f"`{key}`" for key in keys)
        what = f'"{PLACEHOLDER}" is left in {named}'
        yield ResultWarning("placeholder", what, where(keys[0]), _PLACEHOLDER_FIX)


def find_placeholder_cells(table: CsvTable) -> Iterator[ResultWarning]:
    """Yield a warning if cells of a table still contain the placeholder."""
    found = {
        str(name): rows
        for name, column in table.cells.items()
        if _PLACEHOLDER_PATTERN.search("\n".join(column))  # one search a column: a table may be long
        and (rows := [n for n, cell in enumerate(column) if _PLACEHOLDER_PATTERN.search(cell)])
    }
    if found:
        named = ", ".join(f"`{name}`" for name in found)
        what = f'"{PLACEHOLDER}" is left in {sum(map(len, found.values()))} cells of {named}'
        where = table.where(min(rows[0] for rows in found.values()))
        yield ResultWarning("placeholder", what, where, _PLACEHOLDER_FIX)


def _iterate_placeholder_keys(value: object, key: str = "") -> Iterator[str]:
    """Yield the keys of the texts that hold the mark, however deep."""
    if isinstance(value, str) and _PLACEHOLDER_PATTERN.search(value):
        yield key
    members: Iterator[tuple[object, object]] = iter(())
    if isinstance(value, Mapping):
        members = iter(value.items())
    elif isinstance(value, list | tuple):
        members = iter(enumerate(value, start=1))
    for name, inner in members:
        yield from _iterate_placeholder_keys(inner, f"{key}.{name}" if key else str(name))


def find_insertion_warnings(
    record: DatasetRecord, listed: Sequence[ListedInsertion], noise: Noise, file: Path
) -> list[ResultWarning]:
    """Return the warnings about insertions that have no fault."""
    where, insertions = format_place(file), [one.insertion for one in listed]
    column = record.insertions.columns.get("bevel_side", "bevel_side")
    results = [classify_insertion(one.insertion, one.where, noise) for one in listed]
    return [
        *find_side_warnings(results, column, "insertions"),
        *find_pooled_side_warnings(results, column),
        *find_copy_warnings(listed),
        *_find_boundary_warnings(record, insertions, where),
        *_find_missed_surfaces(insertions, where),
        *find_noise_warnings(record, listed, noise, where),
    ]


def _find_boundary_warnings(
    record: DatasetRecord, insertions: Sequence[Insertion], where: FormatPlace
) -> Iterator[ResultWarning]:
    for name, medium in record.media.items():
        depths = [one.depth for one in insertions if one.medium == name]
        key = f"media.{name}.boundaries_mm"
        if medium.boundaries_mm and depths:
            yield from layer_warnings(medium.boundaries_mm, max(depths), where, key)


def _find_missed_surfaces(insertions: Sequence[Insertion], where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning for each medium with surfaces of which no insertion meets any."""
    for name in dict.fromkeys(one.medium for one in insertions):
        group = [one for one in insertions if one.medium == name]
        if all(one.surfaces and one.sequence == (1,) for one in group):
            what = f"none of the {len(group)} insertions into {name} meets any of its surfaces"
            fix = "check that surfaces and centrelines are in one frame (LPS, RAS?), or leave them out"
            yield ResultWarning("surfaces_missed", what, where(f"media.{name}.surfaces"), fix)


MIN_SIMILARITY = 0.8
"""Ratio of `difflib` above which a name counts as a mistyped version of another."""

_UNIT = re.compile(r"_(mm|deg)$")


def find_insertion_column_warnings(
    record: DatasetRecord, names: Iterable[str], path: Path
) -> Iterator[ResultWarning]:
    """Yield a warning for each of these columns of the table of insertions that looks mistyped."""
    source = record.insertions
    ours = [*INSERTION_COLUMNS, SHARED_COLUMN, BASE_SHIFT_COLUMN, *SCAN_COLUMNS]
    if record.frame.pose == "free":
        ours = [name for name in ours if name not in POSE_COLUMNS]
    given = {*source.columns, *source.constants}
    used = {*source.columns.values()}
    if source.file is None:  # the rows are groups of the centreline table
        ours += [*POINT_COLUMNS, SD_COLUMN]
        given |= {*record.centerlines.columns, "id"}
        used |= {*record.centerlines.columns.values(), *record.centerlines.group_by}
    yield from _find_mistyped([name for name in ours if name not in given], used, names, path)


def find_centerline_column_warnings(
    record: DatasetRecord, names: Iterable[str], path: Path
) -> Iterator[ResultWarning]:
    """Yield a warning for each column of a centreline that looks mistyped."""
    source = record.centerlines
    if source.file is not None and record.insertions.file is None:
        return  # one table, which was looked through with the insertions
    missing = [name for name in (*POINT_COLUMNS, SD_COLUMN) if name not in source.columns]
    yield from _find_mistyped(missing, {*source.columns.values(), *source.group_by}, names, path)


def _find_mistyped(
    ours: Iterable[str], used: set[str], names: Iterable[str], path: Path
) -> Iterator[ResultWarning]:
    """Yield a warning for each name that is not used and is like one of `ours` that is absent."""
    there = set(names)
    absent = [name for name in ours if name not in there]
    known = {
        *INSERTION_COLUMNS,
        SHARED_COLUMN,
        BASE_SHIFT_COLUMN,
        *SCAN_COLUMNS,
        *POINT_COLUMNS,
        SD_COLUMN,
        *used,
    }
    for name in sorted(there - known):
        closest = max(absent, key=lambda our: _compute_similarity(name, our), default="")
        if closest and _compute_similarity(name, closest) >= MIN_SIMILARITY:
            what = f"column `{name[:60]}` is not used; did you mean `{closest}`?"
            yield ResultWarning(
                "column", what, f"{path}:1", "rename it, or map it under `columns` in dataset.toml"
            )


def _compute_similarity(one: str, other: str) -> float:
    """Return the similarity of two names, 0 to 1; a unit at the end of both does not count."""
    first, second = (re.sub(r"[\W_]", "", _UNIT.sub("", name.strip().lower())) for name in (one, other))
    if first == second:
        return 1.0
    return SequenceMatcher(None, first, second).ratio() if min(len(first), len(second)) > 2 else 0.0
