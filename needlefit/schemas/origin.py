"""Where needles come from, and how a reader is told that they were not measured."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Literal

#: "example": those of the workbook that ships
Origin = Literal["measured", "example", "synthetic"]

#: marks beside every result, wherever it is shown; beside measured data there is none
ORIGIN_MARKS: Mapping[Origin, str] = MappingProxyType(
    {"measured": "", "example": "EXAMPLE data, simulated", "synthetic": "SYNTHETIC data"}
)
ORIGIN_NOTES: Mapping[Origin, str] = MappingProxyType(
    {
        "measured": "",
        "example": "Example data: simulated needles of the workbook, no evidence for the model.",
        "synthetic": "Synthetic data, no evidence for the model.",
    }
)


def combine_origins(origins: Iterable[str]) -> Origin:
    """Return the origin of what was made of several data: it is measured only if all of them are."""
    distinct = {*origins}
    return "synthetic" if "synthetic" in distinct else "example" if "example" in distinct else "measured"
