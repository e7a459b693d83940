"""Compute, draw and describe the forces on a needle."""

import math
import textwrap

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from needlefit.mechanics.control import Step
from needlefit.mechanics.load import Loads, compute_loads
from needlefit.mechanics.scene import Entry, Scene
from needlefit.mechanics.session import NeedleState
from needlefit.mechanics.shape import compute_positions
from needlefit.reporting.figures import look
from needlefit.reporting.figures.steps import describe_changes, describe_strength

Floats = NDArray[np.float64]

_SEPARATOR = "  ·  "
_ARROW = {
    "arrowstyle": "-|>,head_width=0.12,head_length=0.3",
    "color": look.TIP,
    "lw": 0.8,
    "shrinkA": 0,
    "shrinkB": 0,
}


def compute_state_loads(scene: Scene, moment: NeedleState) -> Loads:
    """Return the loads on the needle in one state."""
    return compute_loads(moment.shape, moment.tissue, scene.needle, moment.step.controls, scene.rules)


def outline_load(entry: Entry, moment: NeedleState, found: Loads, per_mm: float) -> Floats:
    """Return the outline in the world of the drawn load along the shaft: from the needle to the load, and
    back.

    `per_mm` is the load that a drawn millimetre stands for, N/mm.
    """
    if len(found.s) == 0 or per_mm == 0:
        return np.empty((0, 2))
    needle = compute_positions(moment.shape, found.s)
    pulled = needle + np.column_stack((np.zeros(len(needle)), found.load / per_mm))
    return entry.to_world(np.concatenate((needle, pulled[::-1])))


def draw_load(axes: Axes, outline: Floats) -> None:
    """Fill the outline of the load along the shaft."""
    if len(outline):
        axes.fill(*outline.T, zorder=1.8, **look.LOAD)


def draw_tip_force(axes: Axes, entry: Entry, moment: NeedleState, length: float) -> None:
    """Draw the tip force as an arrow of `length` (mm, positive toward C's y) from the tip."""
    if abs(length) < 1e-3:
        return
    tip = compute_positions(moment.shape, moment.shape.x[-1:])[0]
    start, end = entry.to_world([tip, (tip[0], tip[1] + length)])
    axes.annotate("", end, start, arrowprops=_ARROW, zorder=7)


def describe_moment(
    entry: Entry, moment: NeedleState, found: Loads, letters: int
) -> tuple[list[str], list[str]]:
    """Return the text above a drawing: position and supports of the needle, and its tip.

    In lines, the first of at most so many letters.
    """
    step, frame = moment.step, "" if entry == Entry() else " in C"
    position = [
        f"{step.depth:.4g} mm deep",
        *describe_changes(None, step, frame),
        describe_strength(step.bevel, ".3g"),
    ]
    support_forces = [
        f"base {_format_force(found.base.force)}, {_replace_minus(f'{found.base.moment:+z.2f}')} N mm",
        *_guide_forces(step, found),
    ]
    lines = [
        line
        for parts in (position, support_forces)
        for line in textwrap.wrap(_SEPARATOR.join(parts), letters)
    ]
    tip = f"tip {_replace_minus(f'{moment.shape.tip_lateral:+z.2f}')} mm{frame}"
    return lines, [tip, f"tip force {_format_force(found.tip_force)}"]


def round_up(value: float) -> float:
    """Return the smallest of 1, 2, 5, 10, ... (times any power of ten) that is not less than a positive
    value.
    """
    ten = 10.0 ** math.floor(math.log10(value))
    return next(float(f"{step * ten:.1g}") for step in (1, 2, 5, 10) if step * ten >= value * (1 - 1e-9))


def _guide_forces(step: Step, found: Loads) -> list[str]:
    pairs = zip(step.controls.guides, found.guides, strict=True)
    return [
        f"{guide.name or f'guide {n}'} {_format_force(hold.force)}"
        for n, (guide, hold) in enumerate(pairs, start=1)
    ]


def _format_force(newton: float) -> str:
    return _replace_minus(f"{newton:+z.3f} N")


def _replace_minus(text: str) -> str:
    return text.replace("-", "−")
