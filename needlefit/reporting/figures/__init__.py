"""Figures as forms over tidy frames (`forms`), drawn in the same way on every machine (`style`)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Drawing:
    """A figure of a report: a form and its frame."""

    # The name of a function of `forms` or `fit_forms`, or one of a kind's own: frame and options -> figure
    form: "str | Callable[..., Figure]"
    frame: pd.DataFrame  # all that is drawn; it is saved as CSV beside the figure
    options: Mapping[str, Any] = field(default_factory=dict)  # keyword arguments of the form
    # Frame -> the frame that the form draws, where that needs columns which are not saved
    prepare: Callable[[pd.DataFrame], pd.DataFrame] = lambda frame: frame

    optional: bool = False  # drawn where all figures are asked for; its frame is saved in any case

    def save(self, path: Path) -> Path:
        """Draw the figure to `path` (PDF), its frame beside it as CSV; return the path."""
        # late: matplotlib takes its time to load
        from needlefit.reporting.figures import fit_forms, forms, style

        known = {**vars(fit_forms), **vars(forms)}
        paint = known[self.form] if isinstance(self.form, str) else self.form
        return style.plot(path, self.frame, lambda frame: paint(self.prepare(frame), **self.options))


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
