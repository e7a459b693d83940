"""What two answers to the same kind of question differ in, table by table."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.validation.csv_tables import read_table
from needlefit.validation.difference import SLIGHT, VISIBLE, Difference, changed
from needlefit.validation.inquiries.kinds import KINDS

APART = 0.1
"""Part by which a number that is no length may change and say the same."""


def answers_differ(before: Path, after: Path) -> Iterator[Difference]:
    """Yield, for every table that both folders hold, how rows, lengths and other numbers changed.

    Rows are the same if all their words, counts and verdicts are.
    """
    for path in sorted(before.glob("*.csv")):
        if (after / path.name).is_file():
            yield from _table(path.stem, read_table(path), read_table(after / path.name))


def asks(run: Mapping[str, Any]) -> str | None:
    """Return the kind of inquiry that a run answers, or None if it is no answer."""
    study = run.get("study")
    kind = study.get("kind") if isinstance(study, dict) else None
    return kind if isinstance(kind, str) and kind in KINDS else None


def _table(name: str, before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    numbers = [str(one) for one in before if _is_number(before, one) and _is_number(after, one)]
    keys = [str(one) for one in before if one in after and str(one) not in numbers]
    both = _keyed(before, keys).merge(
        _keyed(after, keys),
        on=[*keys, _REPEAT],
        how="outer",
        suffixes=("_a", "_b"),
        indicator="in",
        sort=False,
    )
    alone = both[both["in"] != "both"]
    if len(alone):
        first = ", ".join(str(alone.iloc[0][key]) for key in keys)
        why = f"{len(alone)} rows are in one run only, the first of them: {first}"
        yield Difference("state", f"rows of {name}", len(before), len(after), True, why)
    same = both[both["in"] == "both"].reset_index(drop=True)
    for column in numbers:
        where = f"{name}, {column}"
        if column.endswith("_mm") and "insertion" in keys:
            yield from changed(where, same, column)
        else:
            yield from _greatest(where, same, column, keys)


_REPEAT = "__repeat"


def _keyed(frame: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Return a frame whose rows are told apart by their words, and by their order where these are alike."""
    words = frame.assign(**{key: frame[key].astype(str) for key in keys})
    return words.assign(
        **{_REPEAT: words.groupby(keys, sort=False).cumcount() if keys else range(len(frame))}
    )


def _is_number(frame: pd.DataFrame, column: object) -> bool:
    return column in frame and pd.api.types.is_float_dtype(frame[column])


def _greatest(where: str, rows: pd.DataFrame, column: str, keys: list[str]) -> Iterator[Difference]:
    """Yield the greatest change of a number: of a length in mm, of others beside the size of their column."""
    before, after = (rows[f"{column}_{run}"].to_numpy(dtype=np.float64) for run in "ab")
    gap = np.abs(after - before)
    if not np.any(gap > 0):
        return
    row = int(np.nanargmax(gap))
    at = ", ".join(str(rows.loc[row, key]) for key in keys)
    if column.endswith("_mm"):
        part, why = float(gap[row]) / VISIBLE, f"at most {gap[row]:.3g} mm"
        matters, slight = part > 1, part < SLIGHT
    else:
        size = float(np.nanmax(np.abs(before)))
        part = float(gap[row]) / size if size else np.inf
        why = f"at most {part:.2g} of the largest of its column"
        matters, slight = part > APART, part < SLIGHT * APART
    why = f"{why}: {at}" if at else why
    yield Difference("parameter", where, float(before[row]), float(after[row]), matters, why, slight)
