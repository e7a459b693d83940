"""A scan along the needle: pictures, brightness, deflection and residuals over one axis."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from needlefit.geometry.curves import arc_length
from needlefit.imaging.reconstruction import Reconstruction, ScanView
from needlefit.reporting.figures.labels import spread
from needlefit.reporting.figures.panels import panel, sheet
from needlefit.reporting.figures.pictures import ENTRY, LAYER, NEEDLE, TIP, show, whole_needle
from needlefit.reporting.figures.style import draw, light_grid
from needlefit.reporting.names import GREY, INK

Floats = NDArray[np.float64]
Span = tuple[float, float]

WIDTH, HEIGHT = 180.0, 175.0
"""Of the figure, mm."""

OUT_OF_PLANE = "#D55E00"

_LEFT, _RIGHT, _TOP, _BOTTOM, _GAP = 17.0, 1.0, 4.0, 8.0, 2.5  # mm around and between the panels
_PLOTS = {"core": 9.0, "around": 24.0, "deflection": 24.0, "residuals": 20.0}  # heights, mm
_NINETY_FIVE = 1.96


def along(reconstruction: Reconstruction, path: Path) -> Path:
    """Draw pictures, brightness, deflection and residuals over one axis, x of the constraint frame."""
    return draw(path, lambda: _paint(reconstruction))


def _paint(reconstruction: Reconstruction) -> Figure:
    figure = sheet(WIDTH, HEIGHT)
    pictures = [view for view in reconstruction.views if view.axes[0] == "x"]
    width = WIDTH - _LEFT - _RIGHT
    left, right = pictures[0].extent[:2]
    scale = width / (right - left)  # mm on paper per mm
    taken = _TOP + _BOTTOM + sum(_PLOTS.values()) + _GAP * (len(_PLOTS) + len(pictures) - 1)
    shown = spans(pictures, whole_needle(reconstruction), (HEIGHT - taken) / scale)
    top = HEIGHT - _TOP
    panels: list[Axes] = []
    for view, span in zip(pictures, shown, strict=True):
        height = scale * (span[1] - span[0])
        panels.append(panel(figure, (_LEFT, top - height, width, height)))
        show(panels[-1], view, reconstruction, span)
        panels[-1].set_ylabel(f"{view.axes[1]} in C\n(mm)")
        top -= height + _GAP
    for name, height in _PLOTS.items():
        panels.append(panel(figure, (_LEFT, top - height, width, height)))
        _PAINTERS[name](panels[-1], reconstruction)
        panels[-1].set_xlim(left, right)
        _mark_depths(panels[-1], reconstruction)
        top -= height + _GAP
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel("x along the entry axis (mm)")
    _name_depths(panels[0], reconstruction)
    for axes in panels:
        axes.yaxis.set_label_coords(-10.0 / width, 0.5)
    return figure


def spans(pictures: Sequence[ScanView], needle: Floats, room: float) -> list[Span]:
    """Return what pictures show upwards so that together they are at most `room` mm high, the needle amid."""
    centres, reaches = [], []
    for view in pictures:
        left, right, bottom, top = view.extent
        part = needle[(needle[:, 0] >= left) & (needle[:, 0] <= right), "xyz".index(view.axes[1])]
        centres.append(float(part.min() + part.max()) / 2)
        reaches.append((top - bottom) / 2)
    share = min(1.0, room / (2 * sum(reaches)))
    return [(c - share * reach, c + share * reach) for c, reach in zip(centres, reaches, strict=True)]


def _paint_core(axes: Axes, reconstruction: Reconstruction) -> None:
    profile = reconstruction.profile
    axes.plot(_x_at(reconstruction, profile.s), profile.core, color=INK, lw=0.9)
    axes.set_ylabel("needle\n(HU)")
    axes.yaxis.set_major_locator(MaxNLocator(2))


def _paint_around(axes: Axes, reconstruction: Reconstruction) -> None:
    profile = reconstruction.profile
    axes.plot(_x_at(reconstruction, profile.s), profile.around, color=INK, lw=0.9)
    axes.set_ylabel("surroundings\n(HU)")
    light_grid(axes, "y")


def _paint_deflection(axes: Axes, reconstruction: Reconstruction) -> None:
    x, y, z = reconstruction.local.T
    half = _NINETY_FIVE * reconstruction.sd
    for side, colour, words in ((z, OUT_OF_PLANE, "out of plane, z"), (y, NEEDLE, "deflection, y")):
        axes.fill_between(x, side - half, side + half, color=colour, alpha=0.3, lw=0)
        axes.plot(x, side, color=colour, lw=1.1, label=words)
    axes.axhline(0.0, color=GREY, lw=0.5, zorder=1)
    axes.set_ylabel("in C\n(mm)")
    axes.legend(
        loc="upper left", handlelength=1.3, fontsize=7, borderaxespad=0.2, reverse=True,
        frameon=True, facecolor="white", edgecolor="none", framealpha=1.0, borderpad=0.15,
    )  # fmt: skip
    light_grid(axes, "y")


def _paint_residuals(axes: Axes, reconstruction: Reconstruction) -> None:
    needle_axis = reconstruction.needle_axis
    x = whole_needle(reconstruction)[:, 0]
    turn = reconstruction.frame.rotation.T @ reconstruction.patient.rotation
    beside = needle_axis.residuals @ turn.T  # (S, 3), C
    at = np.interp(needle_axis.sections_s, arc_length(needle_axis.points), x)
    half = _NINETY_FIVE * needle_axis.sd
    axes.fill_between(x, -half, half, color=GREY, alpha=0.3, lw=0, label="the axis, 95 %")
    for side, colour, mark, words in ((2, OUT_OF_PLANE, "D", "in z"), (1, NEEDLE, "o", "in y")):
        axes.plot(at, beside[:, side], mark, color=colour, ms=1.3, mew=0, label=words)
    axes.set_ylabel("sections off\naxis (mm)")
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.15 * (high - low), high + 0.3 * (high - low))  # room for the words
    axes.legend(
        loc="upper left", ncols=3, handlelength=1.0, handletextpad=0.4, columnspacing=1.2, fontsize=7,
        markerscale=2, borderaxespad=0.1, reverse=True,
    )  # fmt: skip
    _mark_tip_model(axes, float(at[-1]), float(x[-1]))
    light_grid(axes, "y")


def _mark_tip_model(axes: Axes, last: float, tip: float) -> None:
    """Say why no cross-section stands near the tip: there a model is fitted whole."""
    across = axes.get_xaxis_transform()
    ends = {"arrowstyle": "|-|,widthA=0.15,widthB=0.15", "color": INK, "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (tip, 0.1), (last, 0.1), xycoords=across, arrowprops=ends, annotation_clip=False)
    axes.annotate(
        "fitted as\na whole", (tip, 0.04), xytext=(3, 0), xycoords=across, textcoords="offset points",
        fontsize=7, va="bottom", linespacing=0.95,
    )  # fmt: skip


_PAINTERS = {
    "core": _paint_core,
    "around": _paint_around,
    "deflection": _paint_deflection,
    "residuals": _paint_residuals,
}


def _depths(reconstruction: Reconstruction) -> list[tuple[float, float, str, str]]:
    """Return place along x, deviation, colour and name of the entry, each boundary and the tip."""
    layers, tip = reconstruction.layers, reconstruction.local[-1, 0]
    found = [(0.0, reconstruction.pose.along_sd, ENTRY, "entry")]
    for n, (depth, sd) in enumerate(zip(layers.boundaries, layers.sd, strict=True)):
        before, after = layers.sequence[n : n + 2]
        found.append((float(depth), float(sd), LAYER, f"{before} → {after}"))
    return [*found, (float(tip), float(reconstruction.needle_axis.tip_sd[0]), TIP, "tip")]


def _mark_depths(axes: Axes, reconstruction: Reconstruction) -> None:
    for at, sd, colour, _ in _depths(reconstruction):
        axes.axvspan(at - _NINETY_FIVE * sd, at + _NINETY_FIVE * sd, color=colour, alpha=0.3, lw=0, zorder=0)
        axes.axvline(at, color=colour, lw=0.7, zorder=1)


def _name_depths(axes: Axes, reconstruction: Reconstruction) -> None:
    """Write over the first panel what the lines through the others are, and where the base lies."""
    top = axes.get_ylim()[1]
    left, right = axes.get_xlim()
    depths = _depths(reconstruction)
    stand = spread(
        [at for at, *_ in depths], [name for *_, name in depths], (WIDTH - _LEFT - _RIGHT) / (right - left)
    )
    for (at, _, colour, name), over in zip(depths, stand, strict=True):
        axes.annotate(
            name, (over, top), xytext=(0, 2.5), textcoords="offset points", ha="center", va="bottom",
            fontsize=7, color=INK, annotation_clip=False,
        )  # fmt: skip
        axes.plot([at, at], [top, top], "v", color=colour, ms=3.2, mew=0, clip_on=False, zorder=6)
    axes.annotate(
        "← base", (left, top), xytext=(0, 2.5), textcoords="offset points", va="bottom", fontsize=7,
    )  # fmt: skip


def _x_at(reconstruction: Reconstruction, s: Floats) -> Floats:
    """Return x in C of places along the needle, `s` from its entry; straight on beyond the tip."""
    points = whole_needle(reconstruction)
    along = arc_length(points)
    along += reconstruction.depth - along[-1]
    beyond = np.clip(s - along[-1], 0, None) + np.clip(s - along[0], None, 0)
    x: Floats = np.interp(s, along, points[:, 0]) + beyond
    return x
