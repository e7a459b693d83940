"""Figures as forms over tidy frames (`forms`), drawn in the same way on every machine (`style`)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import pandas as pd


@dataclass(frozen=True)
class Drawing:
    """A figure of a report: a form and its frame."""

    form: str  # "module.function" of this package: frame and options -> figure
    frame: pd.DataFrame  # all that is drawn; it is saved as CSV beside the figure
    options: Mapping[str, Any] = field(default_factory=dict)  # keyword arguments of the form
    # Frame -> the frame that the form draws, where that needs columns which are not saved
    prepare: Callable[[pd.DataFrame], pd.DataFrame] = lambda frame: frame

    def save(self, path: Path, origin: str) -> Path:
        """Draw the figure to `path` (PDF), its frame with the origin as CSV; return the path."""
        # late: matplotlib takes its time to load, a third of it for texts of help that nobody reads here
        from matplotlib import artist

        artist.kwdoc = lambda artist: ""
        artist.Artist._update_set_signature_and_docstring = lambda: None  # type: ignore[attr-defined]
        from needlefit.reporting.figures.style import plot

        module, _, name = self.form.partition(".")
        paint = getattr(import_module(f"{__package__}.{module}"), name)
        frame = self.frame.assign(origin=origin)
        return plot(path, frame, lambda frame: paint(self.prepare(frame), **self.options))


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


InsertionKey = tuple[str, str]  # fold and insertion
INSERTION_KEYS = ["fold", "insertion"]
HEIGHT_COLUMNS = ["y_mm", "low_mm", "high_mm"]
# share of white in the colour of a band, by its name, which stands in place of a curve's
BAND_WHITE = {"95 %": 0.8, "50 %": 0.56}
TIP_ERROR = "tip error"  # value in place of a curve's name: the row is a tip error of a method
PROFILE_KEYS = ["fold", "parameter"]
VERDICT_COLUMNS = [
    *("fisher_sd", "low", "high", "end_low", "end_high", "rise"),
    *("interval_low", "interval_high", "draw_source", "bound_low", "bound_high"),
]  # columns of the identification
