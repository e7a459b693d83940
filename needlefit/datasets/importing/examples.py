"""The workbook to fill in, and which needles of an import are its simulated examples."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.tables import read_workbook
from needlefit.datasets.points import MIN_POINTS
from needlefit.grouping import group_values

WORKBOOK_FILE = Path(__file__).with_name("workbook.xlsx")
EXAMPLE_SHEET = "example"  # how names of its sheets of examples begin
POINT_DECIMALS = 3  # decimals (of mm) by which examples are recognised: another unit rounds them otherwise

Places = frozenset[tuple[float, ...]]


def find_examples(curves: Iterable[ImportedCurve]) -> list[str]:
    """Return the names of the curves, in mm, all of whose points are points of one example."""
    lines = {curve.name: curve.line for curve in curves if len(curve.line) >= MIN_POINTS}
    return [name for name, line in lines.items() if any(map(_place(line).issubset, _load_examples()))]


@cache
def _load_examples() -> list[Places]:
    """Return the points of each example."""
    _, *rows = dict(read_workbook({}, str(WORKBOOK_FILE)))[f"{EXAMPLE_SHEET} points"]
    lines = group_values((name, point) for name, *point in rows)
    return [_place(np.array(line, dtype=np.float64)) for line in lines.values()]


def _place(line: Floats) -> Places:
    return frozenset(map(tuple, (line.round(POINT_DECIMALS) + 0.0).tolist()))
