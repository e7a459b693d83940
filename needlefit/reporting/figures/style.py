"""How every figure looks, and how it is saved so that the same results give the same bytes."""

from collections.abc import Callable
from pathlib import Path

import matplotlib.style  # no pyplot: figures are made and saved without a global state or a display
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from needlefit.errors import ConfigError
from needlefit.project.outputs import require_folder
from needlefit.reporting.files import write_csv
from needlefit.reporting.names import GREY, INK, SYNTHETIC

WIDTH = 6.7  # inches: the text width of the report, so that figures stand in it at their own size
_STRETCHES = (1, 2, 5, 10, 20, 50, 100)
_METADATA: dict[str, dict[str, None]] = {
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
    ".png": {"Software": None},
}
LOOK = {
    "font.family": "DejaVu Sans",  # ships with matplotlib
    "font.size": 7.5,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "needlefit",
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "savefig.dpi": 200,
    "axes.unicode_minus": True,
}


def plot(path: Path, frame: pd.DataFrame, paint: Callable[[pd.DataFrame], Figure]) -> Path:
    """Draw a table and lay it beside the picture, as CSV: what is drawn is what the table holds, no more.

    Raises
    ------
    ConfigError
        As `draw`.
    """
    draw(path, lambda: paint(frame))
    write_csv(frame, path.with_suffix(".csv"))
    return path


def draw(path: Path, paint: Callable[[], Figure]) -> Path:
    """Paint a figure in the house style, whatever the user's own, and save it by its suffix.

    Raises
    ------
    ConfigError
        If the suffix is none of .pdf, .png and .svg, or the folder does not exist.
    """
    suffix = path.suffix.lower()
    if suffix not in _METADATA:
        raise ConfigError(
            f"cannot draw a `{suffix}` file" if suffix else "the file name has no ending",
            where=str(path),
            expected="a name that ends in .pdf, .png or .svg",
            fix=f"write to {path.stem or 'figure'}.pdf",
        )
    require_folder(path)
    with matplotlib.style.context(["default", LOOK]):
        figure = paint()
        FigureCanvasAgg(figure)
        figure.savefig(path, format=suffix[1:], metadata=_METADATA[suffix])
    return path


def snug(figure: Figure) -> None:
    """Make a figure as high as what is drawn in it: axes of a given aspect need not fill it."""
    figure.draw_without_rendering()
    margin = 0.04  # inches, as the layout leaves at the sides
    figure.set_figheight(figure.get_tightbbox().height + 2 * margin)


def stretch(width: float, height: float) -> int:
    """Return the largest of 1, 2, 5, ... that keeps a drawing of `width` by `height` mm wider than high."""
    fitting = [factor for factor in _STRETCHES if factor * height <= 0.62 * width]
    return fitting[-1] if fitting else 1


def is_synthetic(frame: pd.DataFrame) -> bool:
    """Return whether anything that a figure's table holds is of synthetic data."""
    return bool((frame["origin"] == "synthetic").any())


def label_origin(figure: Figure, synthetic: bool) -> None:
    """Write SYNTHETIC DATA across the top of a figure whose data are."""
    if synthetic:
        figure.suptitle("SYNTHETIC DATA", x=0.995, ha="right", fontsize=7.5, weight="bold", color=SYNTHETIC)


def light_grid(axes: Axes, axis: str) -> None:
    """Draw faint lines behind the data, along one axis only."""
    axes.set_axisbelow(True)
    axes.grid(axis="y" if axis == "y" else "x", color=GREY, alpha=0.25, linewidth=0.4)
