"""A picture of an insertion in several steps: one panel each, in the world."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.mechanics.control import Guide, Step
from needlefit.mechanics.scene import Entry, Scene
from needlefit.mechanics.shape import NeedleShape
from needlefit.reporting.figures import look
from needlefit.reporting.figures.style import WIDTH, snug, stretch
from needlefit.reporting.figures.world import (
    Span,
    base_point,
    draw_layers,
    draw_needle,
    legend_handles,
    needle_line,
    window,
)

_TILTED = 0.01  # from here on a stretched y would show angles that are none
_BETWEEN = "  ·  "  # what a step changed
_LETTER = 0.06  # inches, of 7.5 point type
_TALLEST = 8.5  # inches
_HEAD, _LINE = 0.1, 0.14  # inches above a panel, and of each line there
_MAX_COLUMNS = 4  # each wide enough for the lines above its panel
_LEAST_PANEL = 0.25  # inches of height, where so many panels let the figure grow
_TWO_LINES = 0.4  # inches of height that two lines of text in a panel take, with the needle beside them
_LEAST_WIDTH = 1.0  # inches
MAX_PANELS = 20
"""Of a figure; of more steps as many are shown, evenly, the first and the last among them."""


def paint_steps(title: str, scene: Scene, shapes: Sequence[NeedleShape]) -> Figure:
    """Return a figure with the needle after each of `shapes`, panels sharing their axes in mm.

    y is stretched by the factor that its label states, unless the entry is tilted. Of more than `MAX_PANELS`
    steps as many are shown, as the title says; each then states what changed since the one shown before.
    """
    shown = _shown(len(shapes))
    if len(shown) < len(shapes):
        title = f"{title}{_BETWEEN}{len(shown)} of {len(shapes)} steps"
    steps, shapes = [scene.steps[n] for n in shown], [shapes[n] for n in shown]
    x, y = _window(scene, steps, shapes)
    width, height = x[1] - x[0], y[1] - y[0]
    stacked = width >= 1.4 * height
    rows, columns = (len(shapes), 1) if stacked else (1, len(shapes))
    tilted = abs(np.sin(scene.entry.angle)) > _TILTED
    factor = 1 if tilted or not stacked else stretch(0.8 * width / rows, height)
    earlier = [None, *shown[:-1]]
    heads = [_head(scene, n, past, shape) for n, past, shape in zip(shown, earlier, shapes, strict=True)]
    longest, most_lines = max(len(_BETWEEN.join(head)) for head in heads), max(map(len, heads))
    lines = 1 if stacked and longest * _LETTER < WIDTH - 0.6 else most_lines
    panel = _panel_width(rows, columns, lines, factor * height / width)
    if stacked and panel < longest * _LETTER:  # a column of panels would be narrower than their heads
        lines = most_lines
        rows, columns = _grid(len(shapes), lines, factor * height / width)
        panel = _panel_width(rows, columns, lines, factor * height / width)
    above = _HEAD + _LINE * lines
    low = panel * factor * height / width < _TWO_LINES
    size = (panel * columns + 0.6, rows * (panel * factor * height / width + above) + 0.85)
    figure = Figure(figsize=size)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for n in range(len(shapes), len(grid)):
        grid[n].remove()
        grid[n - columns].tick_params(labelbottom=True)  # now the last one of its column
    for n, (axes, shape) in enumerate(zip(grid, shapes, strict=False)):
        axes.set(xlim=x, ylim=y)
        axes.set_aspect(factor)
        draw_layers(axes, scene, panel / width if n == 0 else None, low)
        draw_needle(axes, scene, steps[n], shape)
        _write_head(axes, heads[n], lines)
    figure.supxlabel("x in the world (mm)", fontsize=7.5)
    said = "y in the world (mm)" + ("" if factor == 1 else f", drawn {factor}× as large as x")
    short = len(said) * _LETTER > size[1] - 0.85  # inches
    figure.supylabel(said.replace(", ", ",\n") if short else said, fontsize=7.5)
    _explain(figure, title, scene)
    snug(figure)
    return figure


def _panel_width(rows: int, columns: int, lines: int, ratio: float) -> float:
    """Return the width of panels, inches, whose height is `ratio` times that, with lines above each."""
    tall = max(_TALLEST / rows - _HEAD - _LINE * lines, _LEAST_PANEL)
    return min(max((WIDTH - 0.6) / columns, _LEAST_WIDTH), tall / ratio)


def _grid(count: int, lines: int, ratio: float) -> tuple[int, int]:
    """Return the rows and columns in which `count` panels are largest."""
    grids = [(math.ceil(count / columns), columns) for columns in range(1, min(count, _MAX_COLUMNS) + 1)]
    return max(grids, key=lambda grid: _panel_width(grid[0], grid[1], lines, ratio))


def _shown(count: int) -> list[int]:
    """Return the numbers, from 0, of the steps that have a panel."""
    return [round(n) for n in np.linspace(0, count - 1, min(count, MAX_PANELS)).tolist()]


def _window(scene: Scene, steps: Sequence[Step], shapes: Sequence[NeedleShape]) -> tuple[Span, Span]:
    """Return the limits in the world that show every needle whole, the entry, the guides, and their axis."""
    drawn = [scene.entry.to_world([[0.0, 0.0], [scene.depth, 0.0]])]
    for step, shape in zip(steps, shapes, strict=True):
        drawn += [needle_line(scene.entry, shape) if shape.converged else base_point(scene, step)]
        drawn += [scene.entry.to_world([[guide.x, guide.y]]) for guide in step.controls.guides]
    least = 1.0 if all(shape.converged for shape in shapes) else 0.1 * scene.needle.length
    return window(np.concatenate(drawn), least)


def _head(scene: Scene, n: int, past: int | None, shape: NeedleShape) -> list[str]:
    """Return which step this is, what changed since step `past`, and where the tip came to lie.

    Places are told in C; where that is not the world, whose axes the panel has, they say so.
    """
    steps, frame = scene.steps, "" if scene.entry == Entry() else " in C"
    before = None if past is None else steps[past]
    back = before is not None and steps[n].depth < before.depth
    number = f"step {n + 1}: " if len(steps) > 1 else ""
    said = f"{number}{'back ' if back else ''}to {steps[n].depth:g} mm"
    end = f"tip {shape.deflection:+z.2f} mm{frame}".replace("-", "−") if shape.converged else ""
    return [said, *changes(before, steps[n], frame), end]


def _write_head(axes: Axes, head: Sequence[str], lines: int) -> None:
    """Write it above a panel: in one line with the tip at the right, or in so many lines."""
    if lines == 1:
        axes.set_title(_BETWEEN.join(head[:-1]), loc="left", pad=3)
        axes.set_title(head[-1], loc="right", pad=3, color=look.TIP)
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
    guides = any(step.controls.guides for step in scene.steps)
    figure.legend(
        handles=legend_handles(guides), loc="outside upper left", ncols=4, handletextpad=0.2,
        columnspacing=1.2, title=title, alignment="left", title_fontsize=8,
    )  # fmt: skip
