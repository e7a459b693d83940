"""The forms of figures: each is a function of a tidy frame, whatever kind of study it comes from."""

from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from needlefit.reporting.figures import Look, Panel
from needlefit.reporting.figures.style import GAP_IN, TEXT_WIDTH_IN, add_legend, draw_grid, set_margins
from needlefit.reporting.labels import INK, SERIES_COLOURS

MAX_NAMED_SERIES = 8  # more series than these are not named one by one


def choose_looks(frame: pd.DataFrame, by: str, looks: Mapping[str, Look] | None = None) -> dict[str, Look]:
    """Return the look of each series, in the order of the frame; those without one get a colour each."""
    names = [str(name) for name in dict.fromkeys(frame[by])]
    if looks is not None:
        return {name: looks[name] for name in looks if name in names}
    colours = (SERIES_COLOURS[n % len(SERIES_COLOURS)] for n in range(len(names)))
    return {name: Look(name, colour) for name, colour in zip(names, colours, strict=True)}


def curves(
    frame: pd.DataFrame,
    x: str,
    by: str,
    panels: Sequence[Panel],
    x_label: str,
    looks: Mapping[str, Look] | None = None,
    size: tuple[float, float] = (0.6 * TEXT_WIDTH_IN, 3.3),
) -> Figure:
    """Draw columns over the column `x`, a series for each value of `by`; a line marks 0."""
    chosen, figure = choose_looks(frame, by, looks), Figure(figsize=size)
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)
    for axes, panel in zip(grid.flat, panels, strict=True):
        for name, look in chosen.items():
            rows = frame[frame[by].astype(str) == name].sort_values(x)
            low, high = (rows[end].astype(float) for end in (panel.low, panel.high))
            axes.fill_between(rows[x], low, high, color=lighten(look.colour, look.white), lw=0, zorder=1)
            axes.plot(rows[x], rows[panel.line], lw=look.width, zorder=3, color=look.colour)
        axes.set_ylabel(panel.label)
        draw_grid(axes, "y")
        axes.axhline(0.0, color=INK, lw=0.5)
    grid[-1, 0].set_xlabel(x_label)
    above = GAP_IN
    if 1 < len(chosen) <= MAX_NAMED_SERIES:
        handles = [
            Line2D([], [], color=curve.colour, lw=curve.width, label=curve.label, solid_capstyle="butt")
            for curve in chosen.values()
        ]
        above = add_legend(figure, handles, 5)
    set_margins(figure, 0.58, above)
    return figure


def lighten(colour: str, share: float) -> tuple[float, float, float]:
    """Return a colour with this share of white: opaque, so that it is the same over every background."""
    red, green, blue = (share + (1 - share) * part for part in to_rgb(colour))
    return red, green, blue
