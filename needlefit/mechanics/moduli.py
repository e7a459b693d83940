"""Published moduli of gels and soft tissues: `moduli.csv`, a range and its source each."""

import csv
from functools import cache
from pathlib import Path
from typing import NamedTuple

FILE = Path(__file__).with_suffix(".csv")
YOUNGS_OVER_SHEAR = 3.0  #: of an incompressible solid


class PublishedModulus(NamedTuple):
    """The range of a modulus that a source states of a medium, kPa."""

    medium: str
    low: float
    high: float
    quantity: str  #: Young's or shear modulus
    source: str

    @property
    def shear_pa(self) -> tuple[float, float]:
        """The range of the shear modulus, Pa."""
        factor = 1e3 / (YOUNGS_OVER_SHEAR if self.quantity.startswith("Young") else 1.0)
        return factor * self.low, factor * self.high


@cache
def read_moduli() -> dict[str, PublishedModulus]:
    """Return the published moduli by the names of their media, in small letters."""
    with FILE.open(encoding="utf-8", newline="") as lines:
        rows = csv.DictReader(lines)
        moduli = [
            PublishedModulus(
                row["medium"], float(row["low_kPa"]), float(row["high_kPa"]), row["quantity"], row["source"]
            )
            for row in rows
        ]
    return {modulus.medium.lower(): modulus for modulus in moduli}
