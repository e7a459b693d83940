"""The points of a curve as they are in a file, before any check."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.faults import Fault
from needlefit.errors import DataError
from needlefit.geometry.measured_curve import MeasuredCurve, measure_curve

MAX_COORDINATE = 1e6  # largest number of a dataset: a kilometre in mm
MIN_POINTS = 5  # smallest number of points of a curve
# steps (mm) to which coordinates are rounded, the coarsest first
ROUNDING_STEPS_MM = (10.0, 5.0, 2.0, 1.0, 0.5, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
ROUNDING_TOLERANCE = 1e-6  # largest distance (mm) of rounded coordinates from a whole multiple of the step


@dataclass(frozen=True)
class Points:
    """The points of one curve and their places in the file."""

    path: Path
    values: NDArray[np.float64]  # (N, 3); coordinates, as in the file
    lines: NDArray[np.int64] | None = None  # (N,); line of each point; None where the format has no lines
    # (N,); standard deviation of each point across the curve, mm; None where the file has none.
    sd: NDArray[np.float64] | None = None
    stated: Mapping[str, str] = field(default_factory=dict)  # fields of the file beside it, as text
    unit: str = ""  # that names in the file state; empty where they do not
    # Fields of the file with a text for each point; a column may then tell several curves apart.
    columns: Mapping[str, Sequence[str]] = field(default_factory=dict)

    @cached_property
    def curve(self) -> MeasuredCurve:
        """The curve of the points, smoothed to their noise."""
        return measure_curve(self.values)

    def part(self, rows: NDArray[np.int64]) -> "Points":
        lines = None if self.lines is None else self.lines[rows]
        sd = None if self.sd is None else self.sd[rows]
        columns = {name: [texts[row] for row in rows] for name, texts in self.columns.items()}
        return replace(self, values=self.values[rows], lines=lines, sd=sd, columns=columns)

    def to_columns(self) -> NDArray[np.float64]:
        """Return the columns of a centreline's file: (N, 3), or (N, 4) with deviations."""
        return self.values if self.sd is None else np.column_stack([self.values, self.sd])

    def where(self, index: int = 0) -> str:
        """Return the place of point `index` for a message."""
        if self.lines is None:
            return f"{self.path}, point {index + 1}"
        return f"{self.path}:{self.lines[index]}" if len(self.lines) else str(self.path)

    def find_faults(self, name: str) -> list[Fault]:
        """Return why the points of curve `name` can be no centreline: too few, or without a place."""
        if len(self.values) < MIN_POINTS:
            return [
                DataError(
                    f"curve {name} has only {len(self.values)} points",
                    expected=f"at least {MIN_POINTS}",
                    fix="sample the needle more densely, or leave it out",
                    where=self.where(),
                )
            ]
        sound = (np.abs(np.nan_to_num(self.values, nan=np.inf)) <= MAX_COORDINATE).all(axis=1)
        bad = np.flatnonzero(~sound)
        if len(bad) == 0:
            return []
        return [
            DataError(
                f"curve {name} has {len(bad)} points that are NaN, infinite or too far away",
                expected="finite numbers, mm",
                fix="remove or fix these points",
                where=self.where(int(bad[0])),
            )
        ]


def find_rounding(curves: Iterable[NDArray[np.float64]]) -> float:
    """Return the step to which coordinates of curves (N, 3) are rounded, mm; 0 if to none, or a fine one.

    An axis along which they do not differ shows none.
    """
    points = np.vstack(list(curves))
    varied = points[:, np.ptp(points, axis=0) > 0]
    for step in ROUNDING_STEPS_MM:
        parts = varied / step
        if varied.size and np.abs(parts - parts.round()).max() < ROUNDING_TOLERANCE / step:
            return step
    return 0.0
