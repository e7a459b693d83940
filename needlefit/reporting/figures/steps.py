"""Figure of an insertion in several steps: one panel each, in the world."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.mechanics.control import Bevel, Guide, Step
from needlefit.mechanics.scene import Entry, Scene
from needlefit.mechanics.shape import NeedleShape
from needlefit.reporting.figures import look
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, choose_vertical_scale, fit_height
from needlefit.reporting.figures.world import (
    Span,
    draw_layers,
    draw_needle,
    find_base,
    find_limits,
    make_legend_handles,
    trace_needle,
)

_MIN_TILT = 0.01  # from here on a stretched y would show angles that are none
_SEPARATOR = "  ·  "  # what a step changed
_LETTER_WIDTH_IN = 0.06  # inches, of 7.5 point type
_MAX_HEIGHT_IN = 8.5  # inches
_HEAD_MARGIN_IN, _LINE_HEIGHT_IN = 0.1, 0.14  # inches above a panel, and of each line there
_MAX_COLUMNS = 4  # each wide enough for the lines above its panel
_MIN_PANEL_IN = 0.25  # inches of height, where so many panels let the figure grow
_TWO_LINES_IN = 0.4  # inches of height that two lines of text in a panel take, with the needle beside them
_MIN_PANEL_WIDTH_IN = 1.0  # inches
MAX_PANELS = 20
"""Number of panels of a figure; of more steps as many are shown at even distances, with the first and the
last."""


def paint_steps(title: str, scene: Scene, shapes: Sequence[NeedleShape]) -> Figure:
    """Return a figure with the needle after each step, one panel per shape, on shared axes in mm.

    y is stretched by the factor that its label states, unless the entry is tilted. Of more than `MAX_PANELS`
    steps, as many are shown and the title states it; each lists the changes since the one shown before.
    """
    shown = _select_steps(len(shapes))
    if len(shown) < len(shapes):
        title = f"{title}{_SEPARATOR}{len(shown)} of {len(shapes)} steps"
    steps, shapes = [scene.steps[n] for n in shown], [shapes[n] for n in shown]
    x, y = _find_limits(scene, steps, shapes)
    width, height = x[1] - x[0], y[1] - y[0]
    stacked = width >= 1.4 * height
    rows, columns = (len(shapes), 1) if stacked else (1, len(shapes))
    tilted = abs(np.sin(scene.entry.angle)) > _MIN_TILT
    factor = 1 if tilted or not stacked else choose_vertical_scale(0.8 * width / rows, height)
    earlier = [None, *shown[:-1]]
    heads = [
        _head_lines(scene, n, past, shape) for n, past, shape in zip(shown, earlier, shapes, strict=True)
    ]
    longest, most_lines = max(len(_SEPARATOR.join(head)) for head in heads), max(map(len, heads))
    lines = 1 if stacked and longest * _LETTER_WIDTH_IN < TEXT_WIDTH_IN - 0.6 else most_lines
    panel = _panel_width(rows, columns, lines, factor * height / width)
    if (
        stacked and panel < longest * _LETTER_WIDTH_IN
    ):  # a column of panels would be narrower than their heads
        lines = most_lines
        rows, columns = _choose_grid(len(shapes), lines, factor * height / width)
        panel = _panel_width(rows, columns, lines, factor * height / width)
    above = _HEAD_MARGIN_IN + _LINE_HEIGHT_IN * lines
    low = panel * factor * height / width < _TWO_LINES_IN
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
    summary = "y in the world (mm)" + ("" if factor == 1 else f", drawn {factor}× as large as x")
    short = len(summary) * _LETTER_WIDTH_IN > size[1] - 0.85  # inches
    figure.supylabel(summary.replace(", ", ",\n") if short else summary, fontsize=7.5)
    _draw_legend(figure, title, scene)
    fit_height(figure)
    return figure


def _panel_width(rows: int, columns: int, lines: int, ratio: float) -> float:
    """Return the width of panels, inches, whose height is `ratio` times that, with lines above each."""
    tall = max(_MAX_HEIGHT_IN / rows - _HEAD_MARGIN_IN - _LINE_HEIGHT_IN * lines, _MIN_PANEL_IN)
    return min(max((TEXT_WIDTH_IN - 0.6) / columns, _MIN_PANEL_WIDTH_IN), tall / ratio)


def _choose_grid(count: int, lines: int, ratio: float) -> tuple[int, int]:
    """Return the rows and columns in which `count` panels are largest."""
    grids = [(math.ceil(count / columns), columns) for columns in range(1, min(count, _MAX_COLUMNS) + 1)]
    return max(grids, key=lambda grid: _panel_width(grid[0], grid[1], lines, ratio))


def _select_steps(count: int) -> list[int]:
    """Return the numbers, from 0, of the steps that have a panel."""
    return [round(n) for n in np.linspace(0, count - 1, min(count, MAX_PANELS)).tolist()]


def _find_limits(scene: Scene, steps: Sequence[Step], shapes: Sequence[NeedleShape]) -> tuple[Span, Span]:
    """Return the limits in the world that show every needle whole, the entry, the guides, and their axis."""
    drawn = [scene.entry.to_world([[0.0, 0.0], [scene.depth, 0.0]])]
    for step, shape in zip(steps, shapes, strict=True):
        drawn += [trace_needle(scene.entry, shape) if shape.converged else find_base(scene, step)]
        drawn += [scene.entry.to_world([[guide.x, guide.y]]) for guide in step.controls.guides]
    least = 1.0 if all(shape.converged for shape in shapes) else 0.1 * scene.needle.length
    return find_limits(np.concatenate(drawn), least)


def _head_lines(scene: Scene, n: int, past: int | None, shape: NeedleShape) -> list[str]:
    """Return which step this is, what changed since step `past`, and where the tip came to lie.

    Positions are in C; the text states this where C differs from the world of the panel's axes.
    """
    steps, frame = scene.steps, "" if scene.entry == Entry() else " in C"
    before = None if past is None else steps[past]
    back = before is not None and steps[n].depth < before.depth
    number = f"step {n + 1}: " if len(steps) > 1 else ""
    summary = f"{number}{'back ' if back else ''}to {steps[n].depth:g} mm"
    end = f"tip {shape.tip_lateral:+z.2f} mm{frame}".replace("-", "−") if shape.converged else ""
    return [summary, *describe_changes(before, steps[n], frame), end]


def _write_head(axes: Axes, head: Sequence[str], lines: int) -> None:
    """Write it above a panel: in one line with the tip at the right, or in so many lines."""
    if lines == 1:
        axes.set_title(_SEPARATOR.join(head[:-1]), loc="left", pad=3)
        axes.set_title(head[-1], loc="right", pad=3, color=look.TIP)
    else:
        axes.set_title("\n".join([*head, *[""] * (lines - len(head))]), loc="left", pad=3)


def describe_strength(bevel: Bevel, digits: str = "g") -> str:
    """Return how strongly a bevel turns the cut: its offset b, or the angle of its cut."""
    if bevel.cut_angle:
        return f"θ {math.degrees(bevel.cut_angle):{digits}}°"
    return f"b {bevel.offset:{digits}} mm"


def describe_changes(before: Step | None, now: Step, frame: str = "") -> list[str]:
    """Return a description of the inputs that a step changed; the bevel of the first step is always included.

    `frame` follows on each place.
    """
    summary = []
    held, past = now.controls, (before or Step(0.0, now.bevel)).controls
    if before is None or before.bevel != now.bevel:
        summary.append(f"bevel {'left' if now.bevel.side > 0 else 'right'}")
        strength = describe_strength(now.bevel)
        if before is not None and describe_strength(before.bevel) != strength:
            summary[-1] += f", {strength}"
    if (held.base_y, held.base_slope) != (past.base_y, past.base_slope):
        turned = held.base_slope != 0 or past.base_slope != 0
        angle = f", {_format_signed(np.degrees(np.arctan(held.base_slope)))}°" if turned else ""
        summary.append(f"base {_format_signed(held.base_y)} mm{frame}{angle}")
    if before is not None and held.guides != past.guides:
        summary += _describe_guides(past.guides, held.guides, frame)
    if held.tip != past.tip:
        summary.append(
            "tip let go" if held.tip is None else f"tip tracked at {_format_signed(held.tip.y)} mm{frame}"
        )
    return summary


def _describe_guides(past: Sequence[Guide], held: Sequence[Guide], frame: str) -> list[str]:
    summary = [
        f"{_name_guide(guide)} {_format_signed(guide.y)} mm{frame}" for guide in held if guide not in past
    ]
    left = {guide.name for guide in held}
    return summary + [f"{_name_guide(guide)} let go" for guide in past if guide.name not in left]


def _name_guide(guide: Guide) -> str:
    return guide.name or "guide"


def _format_signed(value: float) -> str:
    text = f"{value:+z.2f}".rstrip("0").rstrip(".").replace("-", "−")
    return "0" if text in ("+0", "−0") else text


def _draw_legend(figure: Figure, title: str, scene: Scene) -> None:
    guides = any(step.controls.guides for step in scene.steps)
    figure.legend(
        handles=make_legend_handles(guides), loc="outside upper left", ncols=4, handletextpad=0.2,
        columnspacing=1.2, title=title, alignment="left", title_fontsize=8,
    )  # fmt: skip
