"""How series and panels of figures are drawn."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Look:
    """How a series is drawn and named in the legend."""

    label: str
    colour: str
    width: float = 1.1  # of lines, points
    white: float = 0.75  # share of white in the colour of bands


@dataclass(frozen=True)
class Panel:
    """A panel of `curves`: the label of its y axis, and columns as a line, and as the ends of a band."""

    label: str
    line: str
    low: str
    high: str
