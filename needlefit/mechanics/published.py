"""Published moduli of gels and soft tissues, and the angle of a bevel's cut: `published.csv`."""

import csv
from functools import cache
from pathlib import Path
from typing import NamedTuple

FILE = Path(__file__).with_suffix(".csv")
YOUNGS_OVER_SHEAR = 3.0  #: Young's modulus over the shear modulus of an incompressible solid


class PublishedRange(NamedTuple):
    """The range that a source states of a modulus of a medium, kPa, or of an angle, degrees."""

    name: str
    low: float
    high: float
    quantity: str  #: Young's or shear modulus, or an angle
    source: str

    @property
    def shear_pa(self) -> tuple[float, float]:
        """The range of the shear modulus, Pa."""
        factor = 1e3 / (YOUNGS_OVER_SHEAR if self.quantity.startswith("Young") else 1.0)
        return factor * self.low, factor * self.high


@cache
def _read_ranges() -> dict[str, PublishedRange]:
    with FILE.open(encoding="utf-8", newline="") as lines:
        ranges = [
            PublishedRange(row["name"], float(row["low"]), float(row["high"]), row["quantity"], row["source"])
            for row in csv.DictReader(lines)
        ]
    return {published.name.lower(): published for published in ranges}


def read_moduli() -> dict[str, PublishedRange]:
    """Return the published moduli by the names of their media, in small letters."""
    return {
        name: published
        for name, published in _read_ranges().items()
        if published.quantity.endswith("modulus")
    }


def read_cut_angles() -> PublishedRange:
    """Return the range of angles, degrees, at which bevels cut."""
    return _read_ranges()["bevel"]
