"""What is suspicious in a dataset that can be fitted all the same, with file, line and column."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from needlefit.datasets.bevel_side import bent, pooled_side_warnings, side_warnings
from needlefit.datasets.copies import copy_warnings
from needlefit.datasets.formats.csv import Table
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers_met import Placed
from needlefit.datasets.noise_warnings import noise_warnings, stated_warnings
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.unit_warnings import FormatPlace, format_place, layer_warnings, needle_warnings
from needlefit.schemas.dataset import DatasetRecord, SourceRecord, TrackDatasetRecord

FILL_IN = "TO FILL IN"
"""Marks what a template cannot know."""

_FILL_IN = re.compile(r"to[ _-]?fill[ _-]?in", re.IGNORECASE)
_WRITE = "write what was measured; reports print it"


def record_warnings(record: DatasetRecord | TrackDatasetRecord, file: Path) -> list[ResultWarning]:
    """Return what is suspicious in a `dataset.toml` by itself."""
    where = format_place(file)
    found = [*placeholder_warnings(record, where), *needle_warnings(record.needle, where)]
    return [*found, *stated_warnings(record.noise, record.needle.length_mm, where)]


def placeholder_warnings(record: SourceRecord, where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning if texts of a template are still there."""
    keys = list(_holding(record.model_dump(by_alias=True)))
    if keys:
        named = ", ".join(f"`{key}`" for key in keys)
        what = f'"{FILL_IN}" is left in {named}'
        yield ResultWarning("placeholder", what, where(keys[0]), _WRITE)


def placeholder_cells(table: Table) -> Iterator[ResultWarning]:
    """Yield a warning if cells of a table still hold the mark."""
    found = {
        str(name): rows
        for name, column in table.cells.items()
        if _FILL_IN.search("\n".join(column))  # one search a column: a table may be long
        and (rows := [n for n, cell in enumerate(column) if _FILL_IN.search(cell)])
    }
    if found:
        named = ", ".join(f"`{name}`" for name in found)
        what = f'"{FILL_IN}" is left in {sum(map(len, found.values()))} cells of {named}'
        where = table.where(min(rows[0] for rows in found.values()))
        yield ResultWarning("placeholder", what, where, _WRITE)


def _holding(value: object, key: str = "") -> Iterator[str]:
    """Yield the keys of the texts that hold the mark, however deep."""
    if isinstance(value, str) and _FILL_IN.search(value):
        yield key
    members: Iterator[tuple[object, object]] = iter(())
    if isinstance(value, Mapping):
        members = iter(value.items())
    elif isinstance(value, list | tuple):
        members = iter(enumerate(value, start=1))
    for name, inner in members:
        yield from _holding(inner, f"{key}.{name}" if key else str(name))


def insertion_warnings(
    record: DatasetRecord, placed: Sequence[Placed], noise: Noise, file: Path
) -> list[ResultWarning]:
    """Return what is suspicious in sound insertions."""
    where, insertions = format_place(file), [one.insertion for one in placed]
    column = record.insertions.columns.get("bevel_side", "bevel_side")
    bents = [bent(one.insertion, one.where, noise) for one in placed]
    return [
        *side_warnings(bents, column, "insertions"),
        *pooled_side_warnings(bents, column),
        *copy_warnings(placed),
        *_boundary_warnings(record, insertions, where),
        *_missed_warnings(insertions, where),
        *noise_warnings(record, placed, noise, where),
    ]


def _boundary_warnings(
    record: DatasetRecord, insertions: Sequence[Insertion], where: FormatPlace
) -> Iterator[ResultWarning]:
    for name, medium in record.media.items():
        depths = [one.depth for one in insertions if one.medium == name]
        key = f"media.{name}.boundaries_mm"
        if medium.boundaries_mm and depths:
            yield from layer_warnings(medium.boundaries_mm, max(depths), where, key)


def _missed_warnings(insertions: Sequence[Insertion], where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield a warning for each medium with surfaces of which no insertion meets any."""
    for name in dict.fromkeys(one.medium for one in insertions):
        group = [one for one in insertions if one.medium == name]
        if all(one.surfaces and one.sequence == (1,) for one in group):
            what = f"none of the {len(group)} insertions into {name} meets any of its surfaces"
            fix = "check that surfaces and centrelines are in one frame (LPS, RAS?), or leave them out"
            yield ResultWarning("surfaces_missed", what, where(f"media.{name}.surfaces"), fix)
