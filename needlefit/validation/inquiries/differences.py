"""What two answers to the same kind of question differ in, table by table."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.validation.difference import SLIGHT, Difference, changed
from needlefit.validation.inquiries.kinds import KINDS

APART = 0.1
"""Part by which a number that is no length may change and say the same."""


def answers_differ(before: Path, after: Path) -> Iterator[Difference]:
    """Yield, for every table that both folders hold, how lengths, other numbers and words changed.

    Rows are compared in their order: the same question gives the same rows.
    """
    for path in sorted(before.glob("*.csv")):
        if (after / path.name).is_file():
            yield from _table(path.stem, pd.read_csv(path), pd.read_csv(after / path.name))


def asks(run: Mapping[str, Any]) -> bool:
    """Return whether a run is an answer to an inquiry."""
    study = run.get("study")
    return isinstance(study, dict) and study.get("kind") in KINDS


def _table(name: str, before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    if len(before) != len(after):
        why = "other rows: not compared further"
        yield Difference("state", f"rows of {name}", len(before), len(after), True, why)
        return
    for column in (str(one) for one in before if one in after):
        where, one, two = f"{name}, {column}", before[column], after[column]
        if not (pd.api.types.is_float_dtype(one) and pd.api.types.is_float_dtype(two)):
            yield from _words(where, one, two)
        elif column.endswith("_mm"):
            yield from changed(where, pd.DataFrame({f"{column}_a": one, f"{column}_b": two}), column)
        else:
            yield from _numbers(where, one, two)


def _words(where: str, before: pd.Series, after: pd.Series) -> Iterator[Difference]:
    """Yield that words, counts or verdicts changed, with the first of them."""
    other = np.flatnonzero((before != after) & ~(before.isna() & after.isna()))
    if len(other):
        first = int(other[0])
        why = f"{len(other)} of {len(before)} rows, the first of them row {first + 1}"
        yield Difference("state", where, str(before[first]), str(after[first]), True, why)


def _numbers(where: str, before: pd.Series, after: pd.Series) -> Iterator[Difference]:
    """Yield the greatest change of a number, beside the size that the column has."""
    gap = (after - before).abs().to_numpy(dtype=np.float64)
    if not np.any(gap > 0):
        return
    row = int(np.nanargmax(gap))
    size = float(np.nanmax(np.abs(before.to_numpy(dtype=np.float64))))
    part = float(gap[row]) / size if size else np.inf
    why = f"{part:.2g} of the largest of its column, row {row + 1}"
    one, two = float(before[row]), float(after[row])
    yield Difference("parameter", where, one, two, part > APART, why, part < SLIGHT * APART)
