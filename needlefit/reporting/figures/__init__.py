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
    """A figure of a report: a form and its frame.

    Attributes
    ----------
    form : str or callable
        The name of a function of `forms`, or one of a kind's own: frame and options -> figure.
    frame : DataFrame
        All that is drawn; it is saved as CSV beside the figure.
    options : mapping
        Keyword arguments of the form.
    """

    form: "str | Callable[..., Figure]"
    frame: pd.DataFrame
    options: Mapping[str, Any] = field(default_factory=dict)

    def save(self, path: Path) -> Path:
        """Draw the figure to `path` (PDF), its frame beside it as CSV; return the path."""
        from needlefit.reporting.figures import forms, style  # late: matplotlib takes its time to load

        paint = getattr(forms, self.form) if isinstance(self.form, str) else self.form
        return style.plot(path, self.frame, lambda frame: paint(frame, **self.options))


@dataclass(frozen=True)
class Panel:
    """A panel of `curves`: columns as line and as dots, times `scale`; `share` is that of the height."""

    label: str
    line: str = ""
    dots: str = ""
    scale: float = 1.0
    share: float = 1.0
    zero: bool = False
