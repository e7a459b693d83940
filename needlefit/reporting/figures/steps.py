"""A picture of an insertion in several steps: one panel each, in the world."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from needlefit.mechanics.control import Step
from needlefit.mechanics.scene import Entry, Scene
from needlefit.mechanics.shape import NeedleShape, positions
from needlefit.reporting.figures.overlays import stretch
from needlefit.reporting.figures.style import WIDTH
from needlefit.reporting.figures.tissue import layer_label, shades
from needlefit.reporting.names import GREY, INK

Floats = NDArray[np.float64]
Span = tuple[float, float]

BASE, GUIDE, CONSTRAINT, TIP = INK, "#009E73", "#0072B2", "#C8102E"
_FAR = 1e4  # mm: further than any panel reaches
_TILTED = 0.01  # from here on a stretched y would show angles that are none
_TALLEST = 8.5  # inches


def paint_steps(title: str, scene: Scene, shapes: Sequence[NeedleShape]) -> Figure:
    """Return a figure with the needle after each of `shapes`, panels sharing their axes in mm.

    y is stretched by the factor that its label states, unless the entry is tilted.
    """
    x, y = _window(scene, shapes)
    width, height = x[1] - x[0], y[1] - y[0]
    stacked = width >= 1.4 * height
    rows, columns = (len(shapes), 1) if stacked else (1, len(shapes))
    tilted = abs(np.sin(scene.entry.angle)) > _TILTED
    factor = 1 if tilted or not stacked else stretch(0.8 * width / rows, height)
    heads = [_head(scene.steps, n, shape) for n, shape in enumerate(shapes)]
    lines = 1 if stacked else max(map(len, heads))
    above = 0.1 + 0.14 * lines  # inches of what is written above a panel
    panel = min((WIDTH - 0.6) / columns, (_TALLEST / rows - above) * width / (factor * height))  # inches wide
    size = (panel * columns + 0.6, rows * (panel * factor * height / width + above) + 0.85)
    figure = Figure(figsize=size)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for n, (axes, shape) in enumerate(zip(grid, shapes, strict=True)):
        axes.set(xlim=x, ylim=y)
        axes.set_aspect(factor)
        _draw_layers(axes, scene, panel / width if n == 0 else None)
        _draw_needle(axes, scene.entry, scene.steps[n], shape)
        _write_head(axes, heads[n], lines)
    figure.supxlabel("x in the world (mm)", fontsize=7.5)
    drawn = "" if factor == 1 else f", drawn {factor}× as large as x"
    figure.supylabel(f"y in the world (mm){drawn}", fontsize=7.5)
    _explain(figure, title, scene)
    return figure


def _window(scene: Scene, shapes: Sequence[NeedleShape]) -> tuple[Span, Span]:
    """Return the limits in the world that show every needle whole, the entry, the guides, and their axis."""
    drawn = [scene.entry.to_world([[0.0, 0.0], [scene.depth, 0.0]])]
    for step, shape in zip(scene.steps, shapes, strict=False):
        drawn += [_needle(scene.entry, shape)] if shape.converged else []
        drawn += [scene.entry.to_world([[guide.x, guide.y]]) for guide in step.controls.guides]
    points = np.concatenate(drawn)
    low, high = points.min(axis=0), points.max(axis=0)
    room = np.maximum(high - low, 1.0)
    flat = room < 0.2 * room.max()  # a flat drawing needs room for what is written beside the needle
    margin = np.where(flat, 0.3, 0.05) * room
    margin[0] = max(margin[0], 0.25 * room[1] - 0.5 * room[0])  # and a steep one for what is above
    (left, bottom), (right, top) = low - margin, high + margin
    return (float(left), float(right)), (float(bottom), float(top))


def _needle(entry: Entry, shape: NeedleShape) -> Floats:
    return entry.to_world(positions(shape, np.linspace(shape.x[0], shape.depth, 300)))


def _draw_layers(axes: Axes, scene: Scene, scale: float | None) -> None:
    """Shade the layers; with a `scale` (inches per mm) write on them what they are."""
    edges = np.array([0.0, *scene.tissue.boundaries, _FAR])
    for i, ((top, bottom), shade) in enumerate(zip(pairwise(edges), shades(scene.tissue), strict=True)):
        corners = [(top, -_FAR), (bottom, -_FAR), (bottom, _FAR), (top, _FAR)]
        axes.fill(*scene.entry.to_world(corners).T, color=shade, lw=0, zorder=0)
        line = scene.entry.to_world([(top, -_FAR), (top, _FAR)]).T
        axes.plot(*line, color="white" if i else INK, lw=1.2 if i else 0.6, zorder=0.5)
        if scale is not None:
            _label_layer(axes, scene, i, (top, bottom), scale)
    axes.plot(*scene.entry.to_world([(-_FAR, 0), (_FAR, 0)]).T, color=GREY, lw=0.5, ls=(0, (4, 3)), zorder=1)


def _label_layer(axes: Axes, scene: Scene, layer: int, depths: Span, scale: float) -> None:
    """Write on a layer what it is, where it meets the lower edge of the panel, or the left one if it lies."""
    entry, limits = scene.entry, (axes.get_xlim(), axes.get_ylim())
    cos, sin = np.cos(entry.angle), np.sin(entry.angle)
    along = 0 if abs(cos) >= abs(sin) else 1  # the edge's own axis
    (low, high), across = limits[along], limits[1 - along]
    level = across[0] + 0.05 * (across[1] - across[0])
    tops = entry.to_world(
        [[depth, 0.0] for depth in depths]
    )  # from there the boundaries run along (-sin, cos)
    drift = (level - tops[:, 1 - along]) * (-sin / cos if along == 0 else -cos / sin)
    start, end = np.clip(np.sort(tops[:, along] + drift), low, high)
    if end - start > 0.03 * (high - low):
        x, y = ((start + end) / 2, level) if along == 0 else (level, (start + end) / 2)
        roomy = 1.0 if along == 0 else 2.5 if abs(cos) < 0.1 else 0.0  # lines are wider than high
        said = layer_label(scene.tissue, layer, (end - start) * scale * roomy)
        axes.text(
            x, y, said, fontsize=6.5, linespacing=1.3,
            ha="left" if along else "center", va="center" if along else "bottom",
        )  # fmt: skip


def _draw_needle(axes: Axes, entry: Entry, step: Step, shape: NeedleShape) -> None:
    for guide in step.controls.guides:
        x, y = entry.to_world([[guide.x, guide.y]])[0]
        axes.plot(x, y, "o", color=GUIDE, ms=5, mec="white", mew=0.5, zorder=5)
    if not shape.converged:
        return
    axes.plot(*entry.to_world(shape.constraints).T, "x", color=CONSTRAINT, ms=2.8, mew=0.6, zorder=2)
    needle = _needle(entry, shape)
    axes.plot(*needle.T, color=INK, lw=1.1, zorder=3)
    axes.plot(*needle[0], "o", color=BASE, ms=5, zorder=5)
    axes.plot(*needle[-1], "o", color=TIP, ms=4, mec="white", mew=0.4, zorder=6)


def _head(steps: Sequence[Step], n: int, shape: NeedleShape) -> list[str]:
    """Return which step this is, what it changed, and where the tip came to lie."""
    back = n > 0 and steps[n].depth < steps[n - 1].depth
    said = f"step {n + 1}: {'back ' if back else ''}to {steps[n].depth:g} mm"
    end = f"tip {_signed(shape.deflection)} mm" if shape.converged else f"NOT CONVERGED: {shape.status}"
    return [said, *changes(steps[n - 1] if n else None, steps[n]), end]


def _write_head(axes: Axes, head: Sequence[str], lines: int) -> None:
    """Write it above a panel: in one line with the tip at the right, or in so many lines."""
    if lines == 1:
        axes.set_title("  ·  ".join(head[:-1]), loc="left", pad=3)
        axes.set_title(head[-1], loc="right", pad=3, color=TIP)
    else:
        axes.set_title("\n".join([*head, *[""] * (lines - len(head))]), loc="left", pad=3)


def changes(before: Step | None, now: Step) -> list[str]:
    """Return in words which inputs a step changed; the first one's bevel always counts as such."""
    said = []
    held, past = now.controls, (before or Step(0.0, now.bevel)).controls
    if before is None or before.bevel != now.bevel:
        said.append(f"bevel {'left' if now.bevel.side > 0 else 'right'}")
        if before is not None and before.bevel.offset != now.bevel.offset:
            said[-1] += f", b {now.bevel.offset:g} mm"
    if (held.base_y, held.base_slope) != (past.base_y, past.base_slope):
        turned = held.base_slope != 0 or past.base_slope != 0
        angle = f", {_signed(np.degrees(np.arctan(held.base_slope)))}°" if turned else ""
        said.append(f"base {_signed(held.base_y)} mm{angle}")
    if before is not None and held.guides != past.guides:
        places = ", ".join(f"{_signed(guide.y)} mm" for guide in held.guides)
        said.append(f"guide {places or 'let go'}")
    if held.tip != past.tip:
        said.append("tip let go" if held.tip is None else f"tip tracked at {_signed(held.tip.y)} mm")
    return said


def _signed(value: float) -> str:
    text = f"{value:+.2f}".rstrip("0").rstrip(".").replace("-", "−")
    return "0" if text in ("+0", "−0") else text


def _explain(figure: Figure, title: str, scene: Scene) -> None:
    said = [("base", BASE, "o", 5.0), ("constraint points", CONSTRAINT, "x", 2.8), ("tip", TIP, "o", 4.0)]
    if any(step.controls.guides for step in scene.steps):
        said.insert(1, ("guide or template", GUIDE, "o", 5.0))
    handles = [Line2D([], [], color=c, marker=m, ms=s, lw=0, mew=0.6, label=label) for label, c, m, s in said]
    figure.legend(
        handles=handles, loc="outside upper left", ncols=4, handletextpad=0.2, columnspacing=1.2,
        title=title, alignment="left", title_fontsize=8,
    )  # fmt: skip
