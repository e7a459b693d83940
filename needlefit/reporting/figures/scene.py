"""Figure of one simulated scene: the needle in its layers."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.mechanics.control import Controls
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import NeedleShape, compute_positions, map_beam_points
from needlefit.reporting.figures import look
from needlefit.reporting.figures.steps import paint_steps
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, choose_vertical_scale, draw, fit_height
from needlefit.reporting.figures.world import label_layers, shade_layers, write_failure
from needlefit.reporting.labels import GREY, INK

_MAX_HEIGHT_IN = 5.5  # inches: a needle that bends further is drawn narrower
_MARGIN_BEFORE_ENTRY = 0.22  # share of the depth drawn before the entry


def draw_scene(title: str, scene: Scene, shapes: Sequence[NeedleShape], path: Path) -> None:
    """Draw the needle, its layers and its constraint points, mm, to a .pdf, .png or .svg file.

    A scene of one step is drawn in C, as far as it is inserted; one of several, or with anything beside the
    bevel that steers the needle, whole and in the world, a panel a step (of very many steps, some).
    Deflections are small beside depths: y is stretched by the factor that its label states, by none where
    the needle bends enough.

    Parameters
    ----------
    shapes : sequence of NeedleShape
        After each step, up to the one that failed.

    Raises
    ------
    ConfigError
        If the ending of `path` is another one, or its folder does not exist.
    """
    steered = any(step.controls != Controls() for step in scene.steps)
    whole = steered or len(scene.steps) > 1 or scene.depth == 0  # not in the tissue, it has no depth to show
    draw(path, lambda: paint_steps(title, scene, shapes) if whole else _paint(title, scene, shapes[-1]))


def _paint(title: str, scene: Scene, shape: NeedleShape) -> Figure:
    start = max(float(shape.x[0]), -_MARGIN_BEFORE_ENTRY * scene.depth)
    needle = compute_positions(shape, np.linspace(start, shape.depth, 400))  # (400, 2)
    if not shape.converged:
        needle = np.zeros((1, 2))  # there is none to show
    bend = float(np.abs(needle[:, 1]).max()) if shape.converged else 0.1 * scene.depth
    bend = bend or 1.0
    y = (min(needle[:, 1].min(), 0.0) - 0.35 * bend, max(needle[:, 1].max(), 0.0) + 0.35 * bend)
    x = (-_MARGIN_BEFORE_ENTRY * scene.depth, 1.04 * scene.depth)
    factor = choose_vertical_scale(0.8 * (x[1] - x[0]), y[1] - y[0])
    height = factor * (y[1] - y[0]) / (x[1] - x[0])
    width = min(TEXT_WIDTH_IN - 0.6, _MAX_HEIGHT_IN / height)
    figure = Figure(figsize=(width + 0.6, 0.95 + width * height))
    axes = figure.add_subplot()
    axes.set(xlim=x, ylim=y)
    axes.set_aspect(factor)
    _draw_layers(axes, scene, width)
    if shape.converged:
        _draw_needle(axes, shape, needle)
    else:
        write_failure(axes, shape)
    beside = len(title) * 0.065 < width - 2.1  # inches: the legend stands at the right
    axes.set_title(title, loc="left", pad=6 if beside or not shape.converged else 18)
    axes.set_xlabel("x along the entry (mm)")
    axes.set_ylabel("deflection y (mm)" + ("" if factor == 1 else f",\ndrawn {factor}× as large as x"))
    fit_height(figure)
    return figure


def _draw_layers(axes: Axes, scene: Scene, width: float) -> None:
    """Shade the layers, the darker the stiffer, and write each one's modulus where the needle is not."""
    start, end = axes.get_xlim()
    low, high = axes.get_ylim()
    free = 0.04 if high > -low else 0.96
    edges = np.minimum([0.0, *scene.tissue.boundaries, np.inf], end)
    shown = {i: (top, bottom) for i, (top, bottom) in enumerate(pairwise(edges)) if bottom > top}
    scale = width / (end - start)
    labels = label_layers(scene, {i: (bottom - top) * scale for i, (top, bottom) in shown.items()})
    for i, (top, bottom) in shown.items():
        axes.axvspan(top, bottom, color=shade_layers(scene.tissue)[i], lw=0, zorder=0)
        axes.text(
            (top + bottom) / 2, free, labels[i], ha="center", fontsize=6.5,
            va="bottom" if free < 0.5 else "top", linespacing=1.3, transform=axes.get_xaxis_transform(),
        )  # fmt: skip
    for depth in scene.tissue.boundaries[scene.tissue.boundaries < end]:
        axes.axvline(depth, color="white", lw=1.2, zorder=0.5)
    axes.axvline(0.0, color=INK, lw=0.6, zorder=0.5)


def _draw_needle(axes: Axes, shape: NeedleShape, needle: np.ndarray) -> None:
    axes.axhline(0.0, color=GREY, lw=0.5, ls=(0, (4, 3)), zorder=1)
    axes.plot(
        *map_beam_points(shape, shape.constraints).T, zorder=2, label="constraint points", **look.POINTS
    )
    axes.plot(*needle.T, zorder=3, label="needle", **look.NEEDLE)
    tip = needle[-1]
    axes.plot(*tip, zorder=4, **look.TIP_MARK)
    outward = 1 if tip[1] >= 0 else -1
    axes.annotate(
        f"tip {tip[1]:+z.2f} mm".replace("-", "−"), tip, xytext=(4, 11 * outward), textcoords="offset points",
        ha="right", va="center", color=look.TIP,
    )  # fmt: skip
    axes.legend(
        loc="lower right", bbox_to_anchor=(1, 1), ncols=2, handlelength=1.2, borderaxespad=0.2, borderpad=0.1
    )
