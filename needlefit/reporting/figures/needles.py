"""Draw a needle in its layers, in the constraint frame C: from the side and, out of its plane, from above."""

import textwrap
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from needlefit.arrays import Floats
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState
from needlefit.mechanics.shape import compute_positions, map_beam_points
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw
from needlefit.reporting.labels import GREY, INK
from needlefit.reporting.number_format import format_quantity

_LAYER_COLOURS = LinearSegmentedColormap.from_list("layers", ["#f7f4ee", "#d3c7ae"])
_NEEDLE, _POINTS, _TIP = "#4b5158", "#b84f00", "#c8102e"  # colours, as on the page
_MARGIN = 0.1  # share of the depth that is shown before the entry and behind the tip
MAX_TITLE_LETTERS = 100  # longest line of a title (characters)
_POINTS_OF_NEEDLE = 300  # number of points of the line that is drawn


def draw_state(title: str, scene: Scene, state: NeedleState, path: Path) -> None:
    """Draw a needle that has a solution to a .pdf, .png or .svg file.

    ConfigError if the ending of `path` is another one, or its folder does not exist.
    """

    def paint() -> Figure:
        views = ("y", "z") if state.shape.leaves_plane else ("y",)
        figure = Figure(figsize=(TEXT_WIDTH_IN, 1.0 + 2.2 * len(views)))
        panels = figure.subplots(len(views), 1, sharex=True, squeeze=False)[:, 0]
        for axes, axis in zip(panels, views, strict=True):
            _draw_panel(axes, scene, state, "xyz".index(axis))
        words = f"{state.step.depth:.4g} mm deep, tip at {_name_tip(state)}"
        panels[0].set_title(f"{textwrap.fill(title, MAX_TITLE_LETTERS)}\n{words}", loc="left")
        handles, _ = panels[0].get_legend_handles_labels()
        figure.legend(handles=handles, loc="outside lower left", ncols=5, handlelength=1.3)
        panels[-1].set_xlabel("x along the entry (mm)")
        return figure

    draw(path, paint, title)


def _name_tip(state: NeedleState) -> str:
    along_z = f", z = {state.shape.tip_z:z.2f} mm" if state.shape.leaves_plane else ""
    return f"y = {state.shape.tip_lateral:z.2f} mm{along_z}"


def _draw_panel(axes: Axes, scene: Scene, state: NeedleState, across: int) -> None:
    """Draw x and y (`across` 1) or z (2) of the needle, its constraint points and its guides."""
    shape, depth = state.shape, state.shape.depth
    controls, columns = state.step.controls, [0, across]
    needle = compute_positions(shape, np.linspace(shape.x[0], depth, _POINTS_OF_NEEDLE))[:, columns]
    points = map_beam_points(shape, shape.constraints)[:, columns]
    guides = [(guide.x, guide.y if across == 1 else guide.z) for guide in controls.guides]
    begin = min([-_MARGIN * depth, *(x - 1.0 for x, _ in guides)])
    end = (1 + _MARGIN) * max(depth, 1.0)
    shown = np.vstack([needle[needle[:, 0] >= begin], np.reshape(guides, (-1, 2)), np.zeros((1, 2))])[:, 1]
    room = 0.3 * max(float(np.ptp(shown)), 0.01 * (end - begin))
    low, high = float(shown.min()) - room, float(shown.max()) + room
    axes.set(xlim=(begin, end), ylim=(low, high), ylabel=f"{'xyz'[across]} (mm), enlarged")
    _draw_layers(axes, scene, state.tissue.mu, (begin, end))
    axes.plot(*map_beam_points(shape, shape.tip_path)[:, columns].T, color=INK, lw=0.6, label="tip path")
    axes.plot(*points.T, "x", color=_POINTS, ms=2.8, mew=0.6, label="constraint points")
    if guides:
        axes.plot(*np.transpose(guides), "o", color="#007a58", ms=5.0, label="guides")
    axes.plot(*needle.T, color=_NEEDLE, lw=1.4, label="needle")
    axes.plot(*needle[-1], "o", color=_TIP, ms=4.0, label="tip")


def _draw_layers(axes: Axes, scene: Scene, mu: Floats, shown: tuple[float, float]) -> None:
    """Shade the layers, the darker the stiffer, and write name and modulus of those that have room."""
    stiffness = np.log10(mu)
    shades = (stiffness - stiffness.min()) / max(float(np.ptp(stiffness)), 1.0)
    edges = [0.0, *scene.tissue.boundaries, max(shown[1], 0.0)]
    for n, (top, bottom) in enumerate(pairwise(edges)):
        if top >= shown[1]:
            break
        axes.axvspan(top, bottom, color=_LAYER_COLOURS(float(shades[n])), lw=0, zorder=0)
        axes.axvline(top, color=GREY, lw=0.6, zorder=0.5)
        name = (scene.layer_names[n] if scene.layer_names else "") or f"layer {n + 1}"
        width = min(bottom, shown[1]) - top
        if width > 0.15 * (shown[1] - shown[0]):
            words = f"{name}\n{format_quantity('mu_pa', 1e6 * mu[n])}"
            place, system = (top + width / 2, 0.04), axes.get_xaxis_transform()
            axes.text(*place, words, transform=system, fontsize=6.5, ha="center", va="bottom")
