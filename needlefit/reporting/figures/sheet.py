"""The sheet on which moments of an insertion are drawn: what stays from one to the next."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from needlefit.mechanics.control import Controls
from needlefit.mechanics.load import Loads
from needlefit.mechanics.scene import Entry, Scene
from needlefit.mechanics.session import NeedleState
from needlefit.mechanics.shape import compute_positions
from needlefit.reporting.figures import look
from needlefit.reporting.figures.acting import acting, profile, round_up, told
from needlefit.reporting.figures.style import WIDTH, label_origin
from needlefit.reporting.figures.world import Span, legend_handles, needle_line, window

Floats = NDArray[np.float64]

_OUTSIDE = 0.22  # share of the depth shown before the entry, where nothing but the inserted part is shown
_HIGHEST = 0.1  # share of the drawing's length that the largest load takes
_LONGEST = 0.08  # and the largest tip force
_FLATTEST, _STEEPEST = 0.2, 1.1  # height over width
_TALLEST = 6.5  # inches
_LETTER = 0.06  # inches, of 7.5 point type
_TIP = 1.5  # inches, of what is said of the tip
_COLUMN = 1.2  # inches, of the legend, on an average


@dataclass(frozen=True)
class Beside:
    """What a needle is compared with, in its constraint frame C, mm.

    Attributes
    ----------
    measured : (K, 2) array, optional
        A measured needle.
    low, high : (K, 2) arrays, optional
        The edges of the 95 % band of fitted ones.
    synthetic : bool
        Whether the data are; the picture then says so.
    """

    measured: Floats | None = None
    low: Floats | None = None
    high: Floats | None = None
    synthetic: bool = False

    @property
    def curves(self) -> tuple[Floats, ...]:
        """All that is there."""
        return tuple(curve for curve in (self.measured, self.low, self.high) if curve is not None)


@dataclass(frozen=True)
class Sheet:
    """Axes in the world, mm in both directions alike, and the scales of forces.

    Attributes
    ----------
    figure : Figure
    axes : Axes
    scene : Scene
    beside : Beside
    inches : float
        On paper, of a millimetre.
    per_mm : float
        Lateral load that a drawn millimetre stands for, N/mm; 0 where there is none to draw.
    arrow : float
        Length of the arrow of a tip force of one newton, mm.
    letters, lines : int
        Room for what is written above the drawing, beside what is said of the tip.
    """

    figure: Figure
    axes: Axes
    scene: Scene
    beside: Beside
    inches: float
    per_mm: float
    arrow: float
    letters: int
    lines: int


def lay_out(
    title: str, scene: Scene, moments: Sequence[NeedleState], beside: Beside, whole: bool | None = None
) -> Sheet:
    """Return an empty sheet on which each of the moments has room.

    Parameters
    ----------
    title : str
    scene : Scene
    moments : sequence of Moment
    beside : Beside
    whole : bool, optional
        The needle from its base on, or only as far as it is inserted; by default whole where more than the
        bevel steers it.
    """
    if whole is None:
        whole = any(moment.step.controls != Controls() for moment in moments)
    found = [acting(scene, moment) for moment in moments]
    pairs = list(zip(moments, found, strict=True))
    points = _shown(scene, moments, beside, whole)
    span = float(np.ptp(points, axis=0).max())
    per_mm, arrow = _scales(found, span)
    points = np.concatenate([points, *(_forces(scene.entry, *pair, per_mm, arrow) for pair in pairs)])
    x, y = _limits(points, span)
    inches = min((WIDTH - 0.6) / (x[1] - x[0]), _TALLEST / (y[1] - y[0]))
    width, height = inches * (x[1] - x[0]), inches * (y[1] - y[0])
    letters, columns = int((width - _TIP) / _LETTER), int(width / _COLUMN)
    lines = max(len(told(scene.entry, *pair, letters)[0]) for pair in pairs)
    handles = _handles(beside, per_mm, any(moment.step.controls.guides for moment in moments))
    above = 0.75 + 0.14 * (lines + math.ceil(len(handles) / columns))
    figure = Figure(figsize=(width + 0.6, height + above))
    axes = figure.add_subplot()
    axes.set(xlim=x, ylim=y, aspect=1, **_axis_labels(scene.entry))
    _explain(figure, title, handles, columns)
    label_origin(figure, beside.synthetic)
    return Sheet(figure, axes, scene, beside, inches, per_mm, arrow, letters, lines)


def _explain(figure: Figure, title: str, handles: Sequence[Line2D | Patch], columns: int) -> None:
    """Write title and legend above the drawing."""
    figure.legend(
        handles=handles, loc="outside upper left", ncols=columns, handletextpad=0.4, handlelength=1.6,
        columnspacing=1.2, title=title, alignment="left", title_fontsize=8,
    )  # fmt: skip


def _scales(found: Sequence[Loads], span: float) -> tuple[float, float]:
    """Return the load that a drawn millimetre stands for (N/mm), and the length of one newton (mm)."""
    load = max(float(np.abs(one.load).max(initial=0.0)) for one in found)
    force = max(abs(one.tip_force) for one in found)
    per_mm = round_up(load / (_HIGHEST * span)) if load > 0 else 0.0
    return per_mm, _LONGEST * span / force if force > 0 else 0.0


def _limits(points: Floats, span: float) -> tuple[Span, Span]:
    """Return limits of x and y that show all points, and are not too narrow for what is written above."""
    x, y = window(points, _FLATTEST * span)
    more = max(0.0, (y[1] - y[0]) / _STEEPEST - (x[1] - x[0]))
    return (x[0] - more / 2, x[1] + more / 2), y


def _axis_labels(entry: Entry) -> dict[str, str]:
    """Return what the axes are: C's own where the scene says no other world."""
    if entry == Entry():
        return {"xlabel": "x along the entry (mm)", "ylabel": "y (mm)"}
    return {"xlabel": "x in the world (mm)", "ylabel": "y in the world (mm)"}


def _shown(scene: Scene, moments: Sequence[NeedleState], beside: Beside, whole: bool) -> Floats:
    """Return points in the world that a drawing of all these moments must hold, (K, 2) mm."""
    deepest = max(moment.shape.depth for moment in moments)
    start = -scene.needle.length if whole or deepest == 0 else -_OUTSIDE * deepest
    drawn = [scene.entry.to_world([[0.0, 0.0], [deepest, 0.0]])]
    for moment in moments:
        marks = [(guide.x, guide.y) for guide in moment.step.controls.guides]
        drawn += [needle_line(scene.entry, moment.shape), scene.entry.to_world(np.reshape(marks, (-1, 2)))]
    points = np.concatenate([*drawn, *map(scene.entry.to_world, beside.curves)])
    shown: Floats = points[scene.entry.to_frame(points)[:, 0] >= start]
    return shown


def _forces(entry: Entry, moment: NeedleState, found: Loads, per_mm: float, arrow: float) -> Floats:
    """Return points that a drawing of the forces must hold, (K, 2) mm."""
    ((x, y),) = compute_positions(moment.shape, moment.shape.x[-1:])
    pulled = [(x, y + arrow * found.tip_force)]
    return np.concatenate([profile(entry, moment, found, per_mm), entry.to_world(pulled)])


def _handles(beside: Beside, per_mm: float, guides: bool) -> list[Line2D | Patch]:
    """Return what the legend shows."""
    handles: list[Line2D | Patch] = [*legend_handles(guides), Line2D([], [], label="tip path", **look.PATH)]
    if per_mm:
        handles.append(Patch(label=f"lateral load, {per_mm:g} N/mm to the mm", **look.LOAD))
    if beside.measured is not None:
        handles.append(Line2D([], [], label="measured", **look.MEASURED))
    if beside.low is not None:
        handles.append(Patch(label="95 % band", **look.BAND))
    return handles
