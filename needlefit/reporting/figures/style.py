"""The style of all figures, saved so that equal results give equal bytes; layout in mm; positions
of labels.
"""

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from io import BytesIO
from pathlib import Path

import matplotlib.style  # no pyplot: figures are made and saved without a global state or a display
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter
from scipy.optimize import isotonic_regression

from needlefit.arrays import Floats
from needlefit.reporting.fonts import FAMILY, compile_sheet, find_fonts, find_lacking, spell
from needlefit.reporting.labels import ALARM_COLOUR, GREY, INK
from needlefit.reporting.table_files import write_csv

# width (inches) of the text of the report, and of both columns of a paper together (IEEE)
TEXT_WIDTH_IN = 7.16
# width (inches) of one column of a paper; two such figures stand side by side in the report
COLUMN_WIDTH_IN = 3.5
FONT_SIZE_PT = 8.0  # size (points) of letters in figures as they are printed
_fixed_width: ContextVar[float | None] = ContextVar("fixed width of figures", default=None)


@contextmanager
def fix_width(inches: float) -> Iterator[None]:
    """Draw figures whose painters ask `choose_width` in one width, that of a column or of a page."""
    token = _fixed_width.set(inches)
    try:
        yield
    finally:
        _fixed_width.reset(token)


def choose_width(natural: float = TEXT_WIDTH_IN) -> float:
    """Return the width of a figure in inches: its own in the report, or the one of `fix_width`."""
    return _fixed_width.get() or natural


_VERTICAL_SCALES = (1, 2, 5, 10, 20, 50, 100)  # factors by which heights are exaggerated over lengths
_METADATA: dict[str, dict[str, None]] = {".svg": {"Date": None}, ".png": {"Software": None}}
_CANVASES = {".svg": FigureCanvasSVG, ".png": FigureCanvasAgg}
_SAVED_DPI = 300  # resolution (dots per inch) of saved figures, as journals ask for
RC_PARAMS = {
    "font.family": FAMILY,
    "font.size": FONT_SIZE_PT,
    "axes.titlesize": FONT_SIZE_PT,
    "axes.titley": 1.0,  # else matplotlib looks for ticks above the axes, again and again: there are none
    "axes.labelsize": FONT_SIZE_PT,
    "xtick.labelsize": FONT_SIZE_PT,
    "ytick.labelsize": FONT_SIZE_PT,
    "legend.fontsize": FONT_SIZE_PT,
    "figure.titlesize": FONT_SIZE_PT,
    "figure.labelsize": FONT_SIZE_PT,
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
    "svg.fonttype": "none",
    # A fixed salt, or the ids in the file would be random.
    "svg.hashsalt": "needlefit",
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "axes.unicode_minus": True,
}


def plot(path: Path, frame: pd.DataFrame, paint: Callable[[pd.DataFrame], Figure]) -> Path:
    """Draw a table and save the table beside the figure, as CSV: the figure shows only what the table
    contains.
    """
    draw(path, lambda: paint(frame))
    write_csv(frame, path.with_suffix(".csv"))
    return path


def draw(path: Path, paint: Callable[[], Figure]) -> Path:
    """Draw a figure in the package's style, independent of the user's, and save it as .pdf or .png."""
    if path.suffix == ".png":
        path.write_bytes(paint_bytes(paint, ".png"))
    else:
        # text as text, whose fonts typst embeds: matplotlib takes half of its time to a PDF for the part of a
        # font that is used
        path.write_bytes(compile_sheet(paint_bytes(paint, ".svg"), ".svg"))
    return path


def paint_bytes(paint: Callable[[], Figure], suffix: str) -> bytes:
    """Return a figure in the package's style as the bytes of an .svg or .png file."""
    with matplotlib.style.context(["default", RC_PARAMS]):
        with warnings.catch_warnings():  # painters may lay out names before their letters have a font
            warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
            figure = paint()
            if suffix == ".svg":  # its letters stand in the drawing: no part of the figure has to be asked
                drawing = save_figure(figure, suffix)
                if not find_lacking(drawing.decode()):
                    return drawing
        choose_fonts(figure)
        return save_figure(figure, suffix)


def choose_fonts(figure: Figure) -> None:
    """Give each text of a figure fonts that have its letters; those that no font has are spelled."""
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        if isinstance(formatter := axis.get_major_formatter(), FuncFormatter):  # of ticks with names
            axis.set_major_formatter(FuncFormatter(lambda x, n, name=formatter.func: spell(name(x, n))))
    for text in figure.findobj(Text):
        if lacking := find_lacking(text.get_text()):
            text.set_text(spell(text.get_text()))
            text.set_fontfamily([FAMILY, *find_fonts(lacking).values()])


def save_figure(figure: Figure, suffix: str) -> bytes:
    """Return a figure made without pyplot as the bytes of an .svg or .png file."""
    canvas, drawing = _CANVASES[suffix](figure), BytesIO()
    figure.dpi = _SAVED_DPI
    if figure.axes and (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)  # places the axes, which matplotlib else does when it draws
    figure.set_layout_engine("none")
    figure.dpi = _SAVED_DPI  # the layout of an SVG leaves 72
    # `savefig` would draw twice, once for the layout alone
    getattr(canvas, f"print_{suffix[1:]}")(drawing, metadata=_METADATA[suffix])
    return drawing.getvalue()


LETTER_WIDTH_IN = 0.055  # width (inches) of a letter in a legend
_HANDLE_WIDTH_IN = 0.3  # width (inches) of a mark in a legend, with its gaps
_LEGEND_LINE_IN = 0.16  # height (inches) of a legend's line
TITLE_IN = 0.19  # height (inches) of a title
TICKS_IN = 0.2  # height (inches) of the numbers at an axis
LABEL_IN = 0.16  # height (inches) of an axis' label
GAP_IN = 0.12  # gap (inches) between panels, and at edges


def add_legend(figure: Figure, handles: Sequence[Artist], most: int) -> float:
    """Draw a legend above all panels, in as many columns as have room; return its height, inches."""
    longest = LETTER_WIDTH_IN * max(len(str(handle.get_label())) for handle in handles) + _HANDLE_WIDTH_IN
    columns = max(1, min(most, int(figure.get_figwidth() / longest)))
    figure.legend(handles=handles, ncols=columns, loc="upper left", handlelength=1.3, columnspacing=1.2)
    return 0.12 + _LEGEND_LINE_IN * math.ceil(len(handles) / columns)


def set_margins(
    figure: Figure,
    left: float,
    top: float,
    right: float = GAP_IN,
    bottom: float = TICKS_IN + LABEL_IN,
    gaps: tuple[float, float] = (GAP_IN, GAP_IN),
) -> None:
    """Place the panels of a figure by its margins and the gaps across and down, inches.

    The constrained layout measures every text twice, which takes half of the time of a figure.
    """
    width, height = figure.get_size_inches()
    placed = [(axes, spec) for axes in figure.axes if (spec := axes.get_subplotspec()) is not None]
    grid = placed[0][0].get_gridspec()
    assert grid is not None, "panels are of a grid"
    across = (width - left - right - (grid.ncols - 1) * gaps[0]) / grid.ncols
    down = (height - bottom - top - (grid.nrows - 1) * gaps[1]) / grid.nrows
    grid.update(left=left / width, right=1 - right / width, bottom=bottom / height, top=1 - top / height)
    grid.update(wspace=gaps[0] / across, hspace=gaps[1] / down)
    figure.set_layout_engine("none")
    for axes, spec in placed:
        axes.set_position(spec.get_position(figure))


def choose_vertical_scale(width: float, height: float) -> int:
    """Return the largest vertical exaggeration (1, 2, 5, ...) that keeps a drawing of `width` by `height` mm
    wider than high.
    """
    fitting = [factor for factor in _VERTICAL_SCALES if factor * height <= 0.62 * width]
    return fitting[-1] if fitting else 1


def describe_scale(factor: int) -> str:
    """Return how much the vertical scale is exaggerated, as text."""
    return "drawn to scale" if factor == 1 else f"exaggerated × {factor}"


def label_origin(figure: Figure, origin_mark: str) -> None:
    """Write the mark of data that were not measured across the top of a figure."""
    if origin_mark:
        figure.suptitle(origin_mark, x=0.995, ha="right", weight="bold", color=ALARM_COLOUR)


def draw_grid(axes: Axes) -> None:
    """Draw faint horizontal lines behind the data."""
    axes.set_axisbelow(True)
    axes.grid(axis="y", color=GREY, alpha=0.25, linewidth=0.4)


MM_PER_INCH = 25.4  # millimetres in an inch

LETTER_WIDTH_MM = 1.3  # width (mm on paper) of a letter of 7 points
MIN_LABEL_GAP_MM = 1.5  # smallest gap (mm on paper) between two names


def spread_labels(places: Sequence[float], names: Sequence[str], scale: float) -> Floats:
    """Return label positions as near as possible to their places, increasing, without overlap.

    Places are in the panel's units, of which one is `scale` mm on paper.
    """
    widths = LETTER_WIDTH_MM * np.array([len(name) for name in names])
    gaps = (widths[1:] + widths[:-1]) / 2 + MIN_LABEL_GAP_MM
    offsets = np.concatenate([[0.0], np.cumsum(gaps)])
    return separate_positions(np.asarray(places) * scale, offsets) / scale


def separate_positions(places: Sequence[float] | Floats, offsets: Floats) -> Floats:
    """Return the positions nearest to increasing `places` (N,) that are at least as far apart as `offsets`
    (N,).
    """
    # with the least distances taken off, names may coincide but not change places
    return isotonic_regression(np.asarray(places) - offsets).x + offsets
