"""A picture of an insertion in several steps: one panel each, in the world."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from needlefit.mechanics.control import Guide, Step
from needlefit.mechanics.scene import Entry, Scene
from needlefit.mechanics.shape import NeedleShape, positions
from needlefit.reporting.figures.style import WIDTH, snug, stretch
from needlefit.reporting.figures.tissue import layer_labels, shades
from needlefit.reporting.names import GREY, INK

Floats = NDArray[np.float64]
Span = tuple[float, float]

BASE, GUIDE, CONSTRAINT, TIP = INK, "#009E73", "#0072B2", "#C8102E"
_FAR = 1e4  # mm: further than any panel reaches
_TILTED = 0.01  # from here on a stretched y would show angles that are none
_BETWEEN = "  ·  "  # what a step changed
_LETTER = 0.06  # inches, of 7.5 point type
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
    heads = [_head(scene, n, shape) for n, shape in enumerate(shapes)]
    longest = max(len(_BETWEEN.join(head)) for head in heads)
    lines = 1 if stacked and longest * _LETTER < WIDTH - 0.6 else max(map(len, heads))
    above = 0.1 + 0.14 * lines  # inches of what is written above a panel
    panel = min((WIDTH - 0.6) / columns, (_TALLEST / rows - above) * width / (factor * height))  # inches wide
    size = (panel * columns + 0.6, rows * (panel * factor * height / width + above) + 0.85)
    figure = Figure(figsize=size)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for n, (axes, shape) in enumerate(zip(grid, shapes, strict=True)):
        axes.set(xlim=x, ylim=y)
        axes.set_aspect(factor)
        _draw_layers(axes, scene, panel / width if n == 0 else None)
        _draw_needle(axes, scene, scene.steps[n], shape)
        _write_head(axes, heads[n], lines)
    figure.supxlabel("x in the world (mm)", fontsize=7.5)
    said = "y in the world (mm)" + ("" if factor == 1 else f", drawn {factor}× as large as x")
    short = len(said) * _LETTER > size[1] - 0.85  # inches
    figure.supylabel(said.replace(", ", ",\n") if short else said, fontsize=7.5)
    _explain(figure, title, scene)
    snug(figure)
    return figure


def _window(scene: Scene, shapes: Sequence[NeedleShape]) -> tuple[Span, Span]:
    """Return the limits in the world that show every needle whole, the entry, the guides, and their axis."""
    drawn = [scene.entry.to_world([[0.0, 0.0], [scene.depth, 0.0]])]
    for step, shape in zip(scene.steps, shapes, strict=False):
        drawn += [_needle(scene.entry, shape) if shape.converged else _base(scene, step)]
        drawn += [scene.entry.to_world([[guide.x, guide.y]]) for guide in step.controls.guides]
    points = np.concatenate(drawn)
    low, high = points.min(axis=0), points.max(axis=0)
    least = 1.0 if all(shape.converged for shape in shapes) else 0.1 * scene.needle.length
    room = np.maximum(high - low, least)
    flat = room < 0.2 * room.max()  # a flat drawing needs room for what is written beside the needle
    margin = np.where(flat, 0.3, 0.05) * room
    margin[0] = max(margin[0], 0.25 * room[1] - 0.5 * room[0])  # and a steep one for what is above
    margin += 0.5 * (room - (high - low))
    (left, bottom), (right, top) = low - margin, high + margin
    return (float(left), float(right)), (float(bottom), float(top))


def _needle(entry: Entry, shape: NeedleShape) -> Floats:
    return entry.to_world(positions(shape, np.linspace(shape.x[0], shape.depth, 300)))


def _base(scene: Scene, step: Step) -> Floats:
    """Return where a step brings the base, in the world: known whether there is a solution or not."""
    held = step.controls
    y = held.base_y + held.stage_slope * step.depth
    return scene.entry.to_world([[step.depth - scene.needle.length, y]])


def _draw_layers(axes: Axes, scene: Scene, scale: float | None) -> None:
    """Shade the layers; with a `scale` (inches per mm) write on them what they are."""
    edges = np.array([0.0, *scene.tissue.boundaries, _FAR])
    for i, ((top, bottom), shade) in enumerate(zip(pairwise(edges), shades(scene.tissue), strict=True)):
        corners = [(top, -_FAR), (bottom, -_FAR), (bottom, _FAR), (top, _FAR)]
        axes.fill(*scene.entry.to_world(corners).T, color=shade, lw=0, zorder=0)
        line = scene.entry.to_world([(top, -_FAR), (top, _FAR)]).T
        axes.plot(*line, color="white" if i else INK, lw=1.2 if i else 0.6, zorder=0.5)
    axes.plot(*scene.entry.to_world([(-_FAR, 0), (_FAR, 0)]).T, color=GREY, lw=0.5, ls=(0, (4, 3)), zorder=1)
    if scale is not None:
        _label_layers(axes, scene, edges, scale)


def _label_layers(axes: Axes, scene: Scene, edges: Floats, scale: float) -> None:
    """Write on each layer that has room what it is."""
    room = {i: _room(axes, scene.entry, depths) for i, depths in enumerate(pairwise(edges))}
    places = {i: place for i, place in room.items() if place is not None}
    labels = layer_labels(scene, {i: length * scale for i, (_, length) in places.items()})
    along = _runs_along(scene.entry)
    for i, ((x, y), _) in places.items():
        axes.text(
            x, y, labels[i], fontsize=6.5, linespacing=1.3,
            ha="left" if along else "center", va="center" if along else "bottom",
        )  # fmt: skip


def _runs_along(entry: Entry) -> int:
    """Return the axis of the panel's edge that the layers meet: 0 the lower one, 1 the left one."""
    return 0 if abs(np.cos(entry.angle)) >= abs(np.sin(entry.angle)) else 1


def _room(axes: Axes, entry: Entry, depths: Span) -> tuple[Span, float] | None:
    """Return where a layer meets the panel's edge, and how long a line it can hold there, mm."""
    limits, along = (axes.get_xlim(), axes.get_ylim()), _runs_along(entry)
    cos, sin = np.cos(entry.angle), np.sin(entry.angle)
    (low, high), across = limits[along], limits[1 - along]
    level = across[0] + 0.05 * (across[1] - across[0])
    tops = entry.to_world([[depth, 0.0] for depth in depths])  # the boundaries run from there on
    drift = (level - tops[:, 1 - along]) * (-sin / cos if along == 0 else -cos / sin)  # along (-sin, cos)
    start, end = np.clip(np.sort(tops[:, along] + drift), low, high)
    if end - start <= 0.03 * (high - low):
        return None
    middle = float(start + end) / 2
    roomy = 1.0 if along == 0 else 2.5 if abs(cos) < 0.1 else 0.0  # lines are wider than high
    return ((middle, level) if along == 0 else (level, middle)), float(end - start) * roomy


def _draw_needle(axes: Axes, scene: Scene, step: Step, shape: NeedleShape) -> None:
    entry = scene.entry
    for guide in step.controls.guides:
        x, y = entry.to_world([[guide.x, guide.y]])[0]
        axes.plot(x, y, "o", color=GUIDE, ms=5, mec="white", mew=0.5, zorder=5)
    axes.plot(*_base(scene, step)[0], "o", color=BASE, ms=5, zorder=5)
    if not shape.converged:
        write_failure(axes, shape)
        return
    axes.plot(*entry.to_world(shape.constraints).T, "x", color=CONSTRAINT, ms=2.8, mew=0.6, zorder=2)
    needle = _needle(entry, shape)
    axes.plot(*needle.T, color=INK, lw=1.1, zorder=3)
    axes.plot(*needle[-1], "o", color=TIP, ms=4, mec="white", mew=0.4, zorder=6)


def write_failure(axes: Axes, shape: NeedleShape) -> None:
    """Write across a panel without a needle why there is none."""
    axes.text(
        0.5, 0.7, f"no solution: {shape.status}", transform=axes.transAxes, ha="center", va="center",
        fontsize=8.5, color=TIP, zorder=6, bbox={"fc": "white", "alpha": 0.7, "lw": 0, "pad": 2},
    )  # fmt: skip


def _head(scene: Scene, n: int, shape: NeedleShape) -> list[str]:
    """Return which step this is, what it changed, and where the tip came to lie.

    Places are told in C; where that is not the world, whose axes the panel has, they say so.
    """
    steps, frame = scene.steps, "" if scene.entry == Entry() else " in C"
    back = n > 0 and steps[n].depth < steps[n - 1].depth
    number = f"step {n + 1}: " if len(steps) > 1 else ""
    said = f"{number}{'back ' if back else ''}to {steps[n].depth:g} mm"
    end = f"tip {shape.deflection:+z.2f} mm{frame}".replace("-", "−") if shape.converged else ""
    return [said, *changes(steps[n - 1] if n else None, steps[n], frame), end]


def _write_head(axes: Axes, head: Sequence[str], lines: int) -> None:
    """Write it above a panel: in one line with the tip at the right, or in so many lines."""
    if lines == 1:
        axes.set_title(_BETWEEN.join(head[:-1]), loc="left", pad=3)
        axes.set_title(head[-1], loc="right", pad=3, color=TIP)
    else:
        axes.set_title("\n".join([*head, *[""] * (lines - len(head))]), loc="left", pad=3)


def changes(before: Step | None, now: Step, frame: str = "") -> list[str]:
    """Return in words which inputs a step changed; the first one's bevel always counts as such.

    `frame` follows on each place.
    """
    said = []
    held, past = now.controls, (before or Step(0.0, now.bevel)).controls
    if before is None or before.bevel != now.bevel:
        said.append(f"bevel {'left' if now.bevel.side > 0 else 'right'}")
        if before is not None and before.bevel.offset != now.bevel.offset:
            said[-1] += f", b {now.bevel.offset:g} mm"
    if (held.base_y, held.base_slope) != (past.base_y, past.base_slope):
        turned = held.base_slope != 0 or past.base_slope != 0
        angle = f", {_signed(np.degrees(np.arctan(held.base_slope)))}°" if turned else ""
        said.append(f"base {_signed(held.base_y)} mm{frame}{angle}")
    if before is not None and held.guides != past.guides:
        said += _moved(past.guides, held.guides, frame)
    if held.tip != past.tip:
        said.append("tip let go" if held.tip is None else f"tip tracked at {_signed(held.tip.y)} mm{frame}")
    return said


def _moved(past: Sequence[Guide], held: Sequence[Guide], frame: str) -> list[str]:
    said = [f"{_called(guide)} {_signed(guide.y)} mm{frame}" for guide in held if guide not in past]
    left = {guide.name for guide in held}
    return said + [f"{_called(guide)} let go" for guide in past if guide.name not in left]


def _called(guide: Guide) -> str:
    return guide.name or "guide"


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
