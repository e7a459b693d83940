"""Draw a scene in world coordinates: its layers, and a needle in them."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from needlefit.mechanics.control import Step
from needlefit.mechanics.scene import Entry, Scene
from needlefit.mechanics.shape import NeedleShape, compute_positions, map_beam_points
from needlefit.mechanics.tissue import Tissue
from needlefit.reporting.figures import look
from needlefit.reporting.labels import GREY, INK
from needlefit.reporting.number_format import format_quantity

_LETTER_WIDTH_IN, _LABEL_MARGIN_IN, _MODULUS_WIDTH_IN = 0.055, 0.05, 0.58  # inches, of 6.5 point type
Colour = tuple[float, float, float, float]

_LAYER_COLOURS = LinearSegmentedColormap.from_list("layers", ["#f7f4ee", "#d3c7ae"])


def shade_layers(tissue: Tissue) -> list[Colour]:
    """Return one colour per layer."""
    stiffness = np.log10(tissue.mu)
    decades = max(float(np.ptp(stiffness)), 1.0)  # one at least, so that like layers look alike
    return [_LAYER_COLOURS(float((one - stiffness.min()) / decades)) for one in stiffness]


def label_layers(scene: Scene, widths: Mapping[int, float], one_line: bool = False) -> dict[int, str]:
    """Return the labels of the layers (counted from 0) that are wide enough on paper, in inches.

    All of them are called in the same way: by the scene's own names if these fit, or "layer 1", or "1". Its
    modulus stands below, or with `one_line` behind, where a layer has room for it.
    """
    numbered = {i: f"layer {i + 1}" for i in widths}
    own = {i: (scene.layer_names[i] if scene.layer_names else "") or called for i, called in numbered.items()}
    summary = {i: f"{i + 1}" for i in widths}
    for names in (own, numbered):
        if all(_LETTER_WIDTH_IN * len(name) + _LABEL_MARGIN_IN <= widths[i] for i, name in names.items()):
            summary = names
            break
    return {
        i: f"{called}{_format_modulus(scene, i, widths[i], called * one_line)}"
        for i, called in summary.items()
    }


def _format_modulus(scene: Scene, layer: int, width: float, before: str) -> str:
    """Return a layer's modulus, below its name or, where it is given, behind; "" where there is no room."""
    if width <= _MODULUS_WIDTH_IN + _LETTER_WIDTH_IN * len(before):
        return ""
    return f"{', ' if before else chr(10)}{format_quantity('mu_pa', scene.tissue.mu[layer] * 1e6)}"


Floats = NDArray[np.float64]
Span = tuple[float, float]

_BEYOND_PANEL_MM = 1e4  # mm: further than any panel reaches


def trace_needle(entry: Entry, shape: NeedleShape) -> Floats:
    """Return points of the needle from base to tip in the world, (300, 2) mm."""
    return entry.to_world(compute_positions(shape, np.linspace(shape.x[0], shape.depth, 300)))


def find_base(scene: Scene, step: Step) -> Floats:
    """Return the base's position in the world after a step; it is known even without a solution."""
    controls = step.controls
    y = controls.base_y + controls.stage_slope * step.depth
    return scene.entry.to_world([[step.depth - scene.needle.length, y]])


def find_limits(points: Floats, min_span: float) -> tuple[Span, Span]:
    """Return limits in x and y that show all points (K, 2) with a margin, each at least `min_span`
    mm wide.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    room = np.maximum(high - low, min_span)
    flat = room < 0.2 * room.max()  # a flat drawing needs room for what is written beside the needle
    margin = np.where(flat, 0.3, 0.05) * room
    margin[0] = max(margin[0], 0.25 * room[1] - 0.5 * room[0])  # and a steep one for what is above
    margin += 0.5 * (room - (high - low))
    (left, bottom), (right, top) = low - margin, high + margin
    return (float(left), float(right)), (float(bottom), float(top))


def draw_layers(axes: Axes, scene: Scene, scale: float | None, low: bool = False) -> None:
    """Shade the layers; with a `scale` (inches per mm) label them.

    In a `low` panel that is one line, on the side on which there is more room beside the entry's axis.
    """
    edges = np.array([0.0, *scene.tissue.boundaries, _BEYOND_PANEL_MM])
    for i, ((top, bottom), shade) in enumerate(zip(pairwise(edges), shade_layers(scene.tissue), strict=True)):
        corners = [
            (top, -_BEYOND_PANEL_MM),
            (bottom, -_BEYOND_PANEL_MM),
            (bottom, _BEYOND_PANEL_MM),
            (top, _BEYOND_PANEL_MM),
        ]
        axes.fill(*scene.entry.to_world(corners).T, color=shade, lw=0, zorder=0)
        line = scene.entry.to_world([(top, -_BEYOND_PANEL_MM), (top, _BEYOND_PANEL_MM)]).T
        axes.plot(*line, color="white" if i else INK, lw=1.2 if i else 0.6, zorder=0.5)
    axes.plot(
        *scene.entry.to_world([(-_BEYOND_PANEL_MM, 0), (_BEYOND_PANEL_MM, 0)]).T,
        color=GREY,
        lw=0.5,
        ls=(0, (4, 3)),
        zorder=1,
    )
    if scale is not None:
        _label_layers(axes, scene, edges, scale, low)


def _label_layers(axes: Axes, scene: Scene, edges: Floats, scale: float, low: bool) -> None:
    """Write on each layer that has room what it is."""
    bottom, top = (edge - scene.entry.y for edge in axes.get_ylim())
    above = low and top > -bottom
    level = 0.95 if above else 0.05  # of the panel
    room = {
        i: _find_label_place(axes, scene.entry, depths, level) for i, depths in enumerate(pairwise(edges))
    }
    places = {i: place for i, place in room.items() if place is not None}
    labels = label_layers(scene, {i: length * scale for i, (_, length) in places.items()}, low)
    along = _label_axis(scene.entry)
    for i, ((x, y), _) in places.items():
        axes.text(
            x, y, labels[i], fontsize=6.5, linespacing=1.3,
            ha="left" if along else "center", va="center" if along else "top" if above else "bottom",
        )  # fmt: skip


def _label_axis(entry: Entry) -> int:
    """Return the axis of the panel's edge that the layers meet: 0 the lower one, 1 the left one."""
    return 0 if abs(np.cos(entry.angle)) >= abs(np.sin(entry.angle)) else 1


def _find_label_place(axes: Axes, entry: Entry, depths: Span, height: float) -> tuple[Span, float] | None:
    """Return where a layer meets the panel's edge, and how long a line it can hold there, mm.

    `height` is where beside the edge, as a part of the panel.
    """
    limits, along = (axes.get_xlim(), axes.get_ylim()), _label_axis(entry)
    cos, sin = np.cos(entry.angle), np.sin(entry.angle)
    (low, high), across = limits[along], limits[1 - along]
    level = across[0] + height * (across[1] - across[0])
    tops = entry.to_world([[depth, 0.0] for depth in depths])  # the boundaries run from there on
    drift = (level - tops[:, 1 - along]) * (-sin / cos if along == 0 else -cos / sin)  # along (-sin, cos)
    start, end = np.clip(np.sort(tops[:, along] + drift), low, high)
    if end - start <= 0.03 * (high - low):
        return None
    middle = float(start + end) / 2
    roomy = 1.0 if along == 0 else 2.5 if abs(cos) < 0.1 else 0.0  # lines are wider than high
    return ((middle, level) if along == 0 else (level, middle)), float(end - start) * roomy


def draw_needle(axes: Axes, scene: Scene, step: Step, shape: NeedleShape) -> None:
    """Draw a needle, its constraint points and its supports; or the reason why there is no needle."""
    entry = scene.entry
    for guide in step.controls.guides:
        x, y = entry.to_world([[guide.x, guide.y]])[0]
        axes.plot(x, y, zorder=5, **look.GUIDE)
    axes.plot(*find_base(scene, step)[0], zorder=5, **look.BASE)
    if not shape.converged:
        write_failure(axes, shape)
        return
    axes.plot(*entry.to_world(map_beam_points(shape, shape.constraints)).T, zorder=2, **look.POINTS)
    needle = trace_needle(entry, shape)
    axes.plot(*needle.T, zorder=3, **look.NEEDLE)
    axes.plot(*needle[-1], zorder=6, **look.TIP_MARK)


def write_failure(axes: Axes, shape: NeedleShape) -> None:
    """Write the reason why there is no needle across a panel."""
    axes.text(
        0.5, 0.7, f"no solution: {shape.status}", transform=axes.transAxes, ha="center", va="center",
        fontsize=8.5, color=look.TIP, zorder=6, bbox={"fc": "white", "alpha": 0.7, "lw": 0, "pad": 2},
    )  # fmt: skip


def make_legend_handles(guides: bool) -> list[Line2D]:
    """Return the legend's handles for what `draw_needle` draws."""
    summary = [("base", look.BASE), ("constraint points", look.POINTS), ("tip", look.TIP_MARK)]
    if guides:
        summary.insert(1, ("guide or template", look.GUIDE))
    return [Line2D([], [], label=label, **mark) for label, mark in summary]
