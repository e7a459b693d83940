"""Columns of a dataset's tables that are not used and are named almost like one of ours: typing errors."""

import re
from collections.abc import Iterable, Iterator
from difflib import SequenceMatcher
from pathlib import Path

from needlefit.datasets.schema import COLUMNS, MOVED, POINT, POSE, SCAN, SD
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.dataset import DatasetRecord

LEAST_SIMILARITY = 0.8
"""Ratio of `difflib` from which on two names are taken for one, mistyped."""

_UNIT = re.compile(r"_(mm|deg)$")


def insertion_columns(record: DatasetRecord, names: Iterable[str], path: Path) -> Iterator[ResultWarning]:
    """Yield a warning for each column of the table of insertions, with these names, that looks mistyped."""
    source = record.insertions
    ours = [*COLUMNS, MOVED, *SCAN]
    if record.frame.pose == "free":
        ours = [name for name in ours if name not in POSE]
    given = {*source.columns, *source.constants}
    used = {*source.columns.values()}
    if source.file is None:  # the rows are groups of the centreline table
        ours += [*POINT, SD]
        given |= {*record.centerlines.columns, "id"}
        used |= {*record.centerlines.columns.values(), *record.centerlines.group_by}
    yield from _mistyped([name for name in ours if name not in given], used, names, path)


def centerline_columns(record: DatasetRecord, names: Iterable[str], path: Path) -> Iterator[ResultWarning]:
    """Yield a warning for each column of a centreline that looks mistyped."""
    source = record.centerlines
    if source.file is not None and record.insertions.file is None:
        return  # one table, which was looked through with the insertions
    missing = [name for name in (*POINT, SD) if name not in source.columns]
    yield from _mistyped(missing, {*source.columns.values(), *source.group_by}, names, path)


def _mistyped(
    ours: Iterable[str], used: set[str], names: Iterable[str], path: Path
) -> Iterator[ResultWarning]:
    """Yield a warning for each name that is not used and is like one of `ours` that is absent."""
    there = set(names)
    absent = [name for name in ours if name not in there]
    known = {*COLUMNS, MOVED, *SCAN, *POINT, SD, *used}
    for name in sorted(there - known):
        closest = max(absent, key=lambda our: _similarity(name, our), default="")
        if closest and _similarity(name, closest) >= LEAST_SIMILARITY:
            what = f"column `{name[:60]}` is not used; did you mean `{closest}`?"
            yield ResultWarning(
                "column", what, f"{path}:1", "rename it, or map it under `columns` in dataset.toml"
            )


def _similarity(one: str, other: str) -> float:
    """Return how alike two names are, 0 to 1; a unit at the end that both have makes no names alike."""
    first, second = (re.sub(r"[\W_]", "", _UNIT.sub("", name.strip().lower())) for name in (one, other))
    if first == second:
        return 1.0
    return SequenceMatcher(None, first, second).ratio() if min(len(first), len(second)) > 2 else 0.0
