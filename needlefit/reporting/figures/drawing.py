"""Figures as forms over tidy frames."""

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

    # The name of a function of `forms`, or one of another module: frame and options -> figure
    form: "str | Callable[..., Figure]"
    frame: pd.DataFrame  # all that is drawn; it is saved as CSV beside the figure
    options: Mapping[str, Any] = field(default_factory=dict)  # keyword arguments of the form
    # Frame -> the frame that the form draws, where that needs columns which are not saved
    prepare: Callable[[pd.DataFrame], pd.DataFrame] = lambda frame: frame

    def save(self, path: Path) -> Path:
        """Draw the figure to `path` (PDF), its frame beside it as CSV; return the path."""
        # late: matplotlib takes its time to load
        import needlefit.reporting.figures.forms as forms
        from needlefit.reporting.figures.style import plot

        paint = vars(forms)[self.form] if isinstance(self.form, str) else self.form
        return plot(path, self.frame, lambda frame: paint(self.prepare(frame), **self.options))
