"""The points of a curve as they are in a file, before any check."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

MAX_COORDINATE = 1e6
"""No number of a dataset is greater: a kilometre in mm."""


@dataclass(frozen=True)
class Points:
    """The points of one curve and their places in the file.

    Attributes
    ----------
    values : (N, 3) array
        Coordinates, as in the file.
    lines : (N,) array or None
        Line of each point; None where the format has no lines.
    sd : (N,) array or None
        Standard deviation of each point across the curve, mm; None where the file has none.
    columns : tuple of str
        The header of the table that it was read from, if it was one.
    """

    path: Path
    values: NDArray[np.float64]
    lines: NDArray[np.int64] | None = None
    sd: NDArray[np.float64] | None = None
    columns: tuple[str, ...] = ()

    def part(self, rows: NDArray[np.int64]) -> "Points":
        """Return some of the points."""
        lines = None if self.lines is None else self.lines[rows]
        sd = None if self.sd is None else self.sd[rows]
        return replace(self, values=self.values[rows], lines=lines, sd=sd)

    def to_columns(self) -> NDArray[np.float64]:
        """Return the columns of a centreline's file: (N, 3), or (N, 4) with deviations."""
        return self.values if self.sd is None else np.column_stack([self.values, self.sd])

    def unusable(self) -> NDArray[np.int64]:
        """Return which points are not finite, or too far away to be a measurement."""
        sound = (np.abs(np.nan_to_num(self.values, nan=np.inf)) <= MAX_COORDINATE).all(axis=1)
        return np.flatnonzero(~sound)

    def where(self, index: int = 0) -> str:
        """Return the place of point `index` for a message."""
        if self.lines is None:
            return f"{self.path}, point {index + 1}"
        return f"{self.path}:{self.lines[index]}" if len(self.lines) else str(self.path)
