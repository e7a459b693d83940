"""A scan across the needle near its tip, and how well its markers fit."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.views import TIP_SECTION_OFFSET_MM
from needlefit.reporting.figures.panels import panel, sheet
from needlefit.reporting.figures.pictures import MARKER, TIP, show
from needlefit.reporting.figures.style import draw, light_grid
from needlefit.reporting.names import GREY, INK

WIDTH = 86.0
"""Of the figure, mm."""

_MARKERS = 40.0  # mm: height of the markers' panel at most


def across(reconstruction: Reconstruction, path: Path) -> Path:
    """Draw the picture across the needle near its tip, and the markers' distances from their known places."""
    return draw(path, lambda: _paint(reconstruction))


def _paint(reconstruction: Reconstruction) -> Figure:
    view = next(view for view in reconstruction.views if view.axes == ("y", "z"))
    left, right, bottom, top = view.extent
    width = 52.0
    height = width * (top - bottom) / (right - left)
    registration = reconstruction.registration
    rows = 0 if registration is None else len(registration.pairs)
    room = min(3.2 * rows, _MARKERS)
    below = 15.0 + room if rows else 0.0
    total = height + 13.0 + below
    figure = sheet(WIDTH, total)
    axes = panel(figure, (12.0, total - 5.0 - height, width, height))
    show(axes, view, reconstruction, (bottom, top))
    axes.set(xlabel="y in C (mm)", ylabel="z in C (mm)")
    axes.set_title(f"{TIP_SECTION_OFFSET_MM:g} mm before the tip", loc="left", pad=3)
    _point_bevel(axes, reconstruction)
    if rows:
        _paint_markers(panel(figure, (12.0, 9.0, WIDTH - 13.0, room)), reconstruction)
    return figure


def _point_bevel(axes: Axes, reconstruction: Reconstruction) -> None:
    """Draw an arrow from the tip to the side of the bevel's point, where the scan shows it."""
    bevel = (
        reconstruction.frame.rotation.T @ reconstruction.patient.rotation @ reconstruction.needle_axis.bevel
    )
    if not np.isfinite(bevel).all():
        return
    tip, side = reconstruction.local[-1, 1:], bevel[1:]
    (y, z), (far_y, far_z), (text_y, text_z) = tip, tip + 4.0 * side, tip + 4.4 * side
    at = "left" if side[0] >= 0 else "right"
    style = {"arrowstyle": "-|>", "color": TIP, "lw": 0.9, "mutation_scale": 6, "shrinkA": 2, "shrinkB": 0}
    axes.annotate("", (far_y, far_z), (y, z), arrowprops=style, zorder=6)
    axes.annotate("bevel", (text_y, text_z), color=TIP, fontsize=7, ha=at, va="center")


def _paint_markers(axes: Axes, reconstruction: Reconstruction) -> None:
    registration = reconstruction.registration
    assert registration is not None
    rows, order = np.arange(len(registration.pairs)), np.argsort(registration.pairs[:, 1])
    size = np.linalg.norm(registration.residuals[order], axis=1)
    left_out, expected = registration.leave_one_out[order], registration.expected_leave_one_out[order]
    axes.hlines(rows, 0.0, np.fmax(size, left_out), color=GREY, lw=0.5, zorder=1)
    axes.plot(size, rows, "o", color=MARKER, ms=3.2, mew=0, label="in the fit")
    axes.plot(left_out, rows, "o", mfc="white", mec=MARKER, mew=0.8, ms=3.2, label="left out")
    axes.plot(expected, rows, "|", color=INK, ms=7, mew=0.9, label="left out, expected")
    axes.set_yticks(rows, [f"{known}" for known in registration.pairs[order, 1]])
    axes.set(ylim=(len(rows) - 0.5, -0.5), ylabel="marker", xlabel="distance from its known place (mm)")
    axes.set_xlim(left=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, handletextpad=0.1, columnspacing=1.0,
        fontsize=7, borderaxespad=0.1,
    )  # fmt: skip
    light_grid(axes, "x")
