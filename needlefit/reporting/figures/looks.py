"""How series and panels of figures are drawn."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Look:
    """How a series is drawn and named in the legend."""

    label: str
    colour: str
    marker: str = "o"  # as of matplotlib; "" none
    dashes: Any = "-"  # line style
    # `size`, `width`: of marks and lines, points
    size: float = 3.4
    width: float = 1.1
    white: float = 0.75  # share of white in the colour of bands


@dataclass(frozen=True)
class Panel:
    """A panel of `curves`: columns as a line, and as a band."""

    label: str  # of the y axis
    # `line`, `low`, `high`: columns; empty: not drawn
    line: str = ""
    low: str = ""
    high: str = ""
    zero: bool = False  # whether a line marks 0
