"""Measured and fitted needles in the scan's coordinates, with 95 % bands: as records and as a table."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from needlefit.arrays import Floats

#: Of the table "needles": every insertion held out, or, of a single fold, any, point by point in its scan.
NEEDLE_COLUMNS = (
    *("fold", "role", "insertion", "diameter_mm", "band_source"),
    *("curve", "j", "x_mm", "y_mm", "z_mm"),
)


@dataclass(frozen=True)
class Band:
    """The simultaneous 95 % band across a needle, in its bending plane; (K, 3) each, LPS, mm."""

    low: Floats
    middle: Floats
    high: Floats
    source: Literal["predicted", "posterior"]  #: of a held-out needle what was predicted to be measured


@dataclass(frozen=True)
class NeedleInScan:
    """One insertion in the patient coordinates of its scan, LPS, mm."""

    insertion: str
    fold: str
    role: str  # "validate" where the fit never saw it, else "tune"
    measured: Floats  # (N, 3); the centreline, entry first
    diameter: float  # of the needle as it is drawn
    fitted: Floats | None = None  # (K, 3); in the bending plane; None where the solve failed
    band: Band | None = None  # None where no draws are certified, or none of them has a solution


def tabulate_needles_in_scan(needles: Iterable[NeedleInScan]) -> pd.DataFrame:
    """Return needles point by point: columns `NEEDLE_COLUMNS`."""
    rows = []
    for needle in needles:
        band = needle.band
        about = (needle.fold, needle.role, needle.insertion, needle.diameter, band.source if band else "")
        curves = {"measured": needle.measured}
        curves |= {} if needle.fitted is None else {"fitted": needle.fitted}
        curves |= {} if band is None else {"low": band.low, "middle": band.middle, "high": band.high}
        rows += [
            (*about, curve, j, *point)
            for curve, points in curves.items()
            for j, point in enumerate(points.tolist())
        ]
    return pd.DataFrame(rows, columns=list(NEEDLE_COLUMNS))
