"""Figures of a refused scan: projections with all candidates, and the brightness along the needle."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length
from needlefit.imaging.findings import Findings
from needlefit.imaging.volume import VoxelGrid
from needlefit.reporting.figures.scan_views import ENTRY_COLOUR, MARKER_COLOUR, NEEDLE_COLOUR, TIP_COLOUR
from needlefit.reporting.figures.style import add_panel_mm, draw_grid, make_figure_mm
from needlefit.reporting.labels import GREY, INK

_WINDOW_HU = (-700.0, 3000.0)
_ACROSS_MM, _GAP_MM, _LEFT_MM, _BOTTOM_MM = 86.0, 10.0, 15.0, 9.0
_PROFILE_MM = 26.0
_MAX_VIEW_MM = 92.0
_AXES = "ijk"
_VIEWS: tuple[tuple[int, int], ...] = ((0, 1), (0, 2), (1, 2))
"""To the right and upwards, axes of the voxels, in each projection: along k, along j, along i."""


def paint_along(found: Findings | None) -> Figure:
    figure = make_figure_mm(180.0, 175.0)
    if found is None:
        return figure
    width = (180.0 - 2 * _LEFT_MM - _GAP_MM) / 2
    extent = np.array(found.grid.size) * found.grid.spacing
    scale = min(width / extent[0], width / extent[1], _MAX_VIEW_MM / extent[2])
    for n, view in enumerate((1, 2)):
        right, up = _VIEWS[view]
        box = (_LEFT_MM + n * (width + _LEFT_MM + _GAP_MM), 172.0 - scale * extent[up])
        _paint_view(add_panel_mm(figure, (*box, scale * extent[right], scale * extent[up])), found, view)
    if found.profile is not None:
        _paint_profile(figure, found)
    return figure


def paint_across(found: Findings | None) -> Figure:
    if found is None:
        return make_figure_mm(_ACROSS_MM, 20.0)
    extent = np.array(found.grid.size) * found.grid.spacing
    scale = min((_ACROSS_MM - _LEFT_MM) / extent[0], 70.0 / extent[1])
    figure = make_figure_mm(_ACROSS_MM, scale * extent[1] + _BOTTOM_MM + 2)
    _paint_view(add_panel_mm(figure, (_LEFT_MM, _BOTTOM_MM, scale * extent[0], scale * extent[1])), found, 0)
    return figure


def _paint_view(axes: Axes, found: Findings, view: int) -> None:
    """Draw a projection in mm from the first voxel, with all candidates."""
    right, up = _VIEWS[view]
    extent = np.array(found.grid.size) * found.grid.spacing
    axes.imshow(
        found.projections[view], cmap="gray", vmin=_WINDOW_HU[0], vmax=_WINDOW_HU[1], origin="lower",
        extent=(0.0, extent[right], 0.0, extent[up]), aspect="equal", interpolation="nearest",
    )  # fmt: skip
    for n, tube in enumerate(found.tubes, start=1):
        ends = _to_voxel_mm(found.grid, tube.ends)[:, [right, up]]
        axes.plot(*ends.T, color=NEEDLE_COLOUR, lw=1.4 if tube.chosen else 0.7)
        axes.annotate(str(n), ends[0], color=NEEDLE_COLOUR, fontsize=7, fontweight="bold")
    for n, ball in enumerate(found.balls, start=1):
        at = tuple(_to_voxel_mm(found.grid, ball.center)[0, [right, up]].tolist())
        fill = MARKER_COLOUR if ball.marker else "none"
        axes.plot(*at, "o", mec=MARKER_COLOUR, mfc=fill, ms=4, mew=0.9)
        axes.annotate(str(n), at, (3, 2), textcoords="offset points", color=MARKER_COLOUR, fontsize=7)
    if found.needle is not None:
        tip = _to_voxel_mm(found.grid, found.needle[-1:])[0, [right, up]]
        axes.plot(*tip, "o", color=TIP_COLOUR, ms=3, mew=0)
    entries = _to_voxel_mm(found.grid, found.entry_points)[:, [right, up]]
    for n, at in enumerate(entries, start=1):
        axes.plot(*at, "D", mec=ENTRY_COLOUR, mfc="none", ms=4, mew=0.9)
        axes.annotate(str(n), at, (3, -7), textcoords="offset points", color=ENTRY_COLOUR, fontsize=7)
    axes.set(xlim=(0, extent[right]), ylim=(0, extent[up]))
    axes.set(xlabel=f"along {_AXES[right]} (mm)", ylabel=f"along {_AXES[up]} (mm)")


def _to_voxel_mm(grid: VoxelGrid, points: Floats) -> Floats:
    """Return points (N, 3), LPS, along the voxels' axes, mm from the first voxel's outer corner."""
    moved: Floats = (np.atleast_2d(points) - grid.origin) @ grid.direction + grid.spacing / 2
    return moved


def _paint_profile(figure: Figure, found: Findings) -> None:
    profile, needle = found.profile, found.needle
    assert profile is not None and needle is not None
    tip = float(arc_length(needle)[-1])
    for n, (values, name) in enumerate(((profile.around, "surroundings"), (profile.core, "needle"))):
        bottom = _BOTTOM_MM + n * (_PROFILE_MM + 3.0)
        axes = add_panel_mm(figure, (_LEFT_MM, bottom, 180.0 - _LEFT_MM - 1.0, _PROFILE_MM))
        axes.plot(profile.s - tip, values, color=INK, lw=0.9)
        axes.axvline(0.0, color=TIP_COLOUR, lw=0.7)
        for number, one in enumerate(found.entries, start=1):
            axes.axvline(-one.depth, color=ENTRY_COLOUR, lw=0.8, ls="-" if one.change == "rise" else ":")
            if n:
                at = (-one.depth, 1.0)
                axes.annotate(
                    str(number), at, (0, 1), xycoords=("data", "axes fraction"), ha="center",
                    textcoords="offset points", fontsize=7, color=ENTRY_COLOUR,
                )  # fmt: skip
        axes.set_ylabel(f"{name}\n(HU)")
        axes.yaxis.set_label_coords(-9.0 / (180.0 - _LEFT_MM), 0.5)
        axes.yaxis.set_major_locator(MaxNLocator(3))
        draw_grid(axes, "y")
        if n:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("along the needle from its tip (mm)")
            axes.axhline(0.0, color=GREY, lw=0.4)
