"""Figure of one state of an insertion, at equal scale in both directions: the needle and the forces on it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

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
from needlefit.mechanics.shape import compute_positions, map_beam_points
from needlefit.reporting.figures import look
from needlefit.reporting.figures.forces import (
    compute_state_loads,
    describe_moment,
    draw_load,
    draw_tip_force,
    outline_load,
    round_up,
)
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw, fit_height, label_origin
from needlefit.reporting.figures.world import (
    Span,
    draw_layers,
    draw_needle,
    find_limits,
    make_legend_handles,
    trace_needle,
)

Floats = NDArray[np.float64]

_MARGIN_BEFORE_ENTRY = (
    0.22  # share of the depth shown before the entry, where nothing but the inserted part is shown
)
_MAX_LOAD_FRACTION = 0.1  # share of the drawing's length that the largest load takes
_MAX_FORCE_FRACTION = 0.08  # and the largest tip force
_MIN_HEIGHT_RATIO, _MAX_HEIGHT_RATIO = 0.2, 1.1  # height over width
_MAX_HEIGHT_IN = 6.5  # inches
_LETTER_WIDTH_IN = 0.06  # inches, of 7.5 point type
_TIP_TEXT_WIDTH_IN = 1.5  # inches, of the text on the tip
_LEGEND_COLUMN_WIDTH_IN = 1.2  # inches, of the legend, on an average


@dataclass(frozen=True)
class SceneOverlays:
    """Curves to compare a needle with, in its constraint frame C, mm.

    Attributes
    ----------
    measured : (K, 2) array, optional
        A measured needle.
    low, high : (K, 2) arrays, optional
        The edges of the 95 % band of fitted ones.
    synthetic : bool
        Whether the data are synthetic; the figure is then labelled.
    """

    measured: Floats | None = None
    low: Floats | None = None
    high: Floats | None = None
    synthetic: bool = False

    @property
    def curves(self) -> tuple[Floats, ...]:
        """All curves that exist."""
        return tuple(curve for curve in (self.measured, self.low, self.high) if curve is not None)


@dataclass(frozen=True)
class MomentFigure:
    """A figure with axes in the world, at equal scale in both directions, and the scales of forces.

    Attributes
    ----------
    figure : Figure
    axes : Axes
    scene : Scene
    overlays : SceneOverlays
    inches : float
        On paper, of a millimetre.
    per_mm : float
        Lateral load per drawn millimetre, N/mm; 0 without a load.
    arrow : float
        Length of the arrow of a tip force of one newton, mm.
    letters, lines : int
        Room for the text above the drawing, beside the text on the tip.
    """

    figure: Figure
    axes: Axes
    scene: Scene
    overlays: SceneOverlays
    inches: float
    per_mm: float
    arrow: float
    letters: int
    lines: int


def lay_out_moments(
    title: str,
    scene: Scene,
    moments: Sequence[NeedleState],
    overlays: SceneOverlays,
    whole: bool | None = None,
) -> MomentFigure:
    """Return an empty figure that has room for each of the states.

    Parameters
    ----------
    title : str
    scene : Scene
    moments : sequence of NeedleState
    overlays : SceneOverlays
    whole : bool, optional
        The needle from its base on, or only as far as it is inserted; by default whole where more than the
        bevel steers it.
    """
    if whole is None:
        whole = any(moment.step.controls != Controls() for moment in moments)
    found = [compute_state_loads(scene, moment) for moment in moments]
    pairs = list(zip(moments, found, strict=True))
    points = _collect_points(scene, moments, overlays, whole)
    span = float(np.ptp(points, axis=0).max())
    per_mm, arrow = _choose_scales(found, span)
    points = np.concatenate(
        [points, *(_collect_force_points(scene.entry, *pair, per_mm, arrow) for pair in pairs)]
    )
    x, y = _find_limits(points, span)
    inches = min((TEXT_WIDTH_IN - 0.6) / (x[1] - x[0]), _MAX_HEIGHT_IN / (y[1] - y[0]))
    width, height = inches * (x[1] - x[0]), inches * (y[1] - y[0])
    letters, columns = (
        int((width - _TIP_TEXT_WIDTH_IN) / _LETTER_WIDTH_IN),
        int(width / _LEGEND_COLUMN_WIDTH_IN),
    )
    lines = max(len(describe_moment(scene.entry, *pair, letters)[0]) for pair in pairs)
    handles = _make_handles(overlays, per_mm, any(moment.step.controls.guides for moment in moments))
    above = 0.75 + 0.14 * (lines + math.ceil(len(handles) / columns))
    figure = Figure(figsize=(width + 0.6, height + above))
    axes = figure.add_subplot()
    axes.set(xlim=x, ylim=y, aspect=1, **_axis_labels(scene.entry))
    _draw_legend(figure, title, handles, columns)
    label_origin(figure, overlays.synthetic)
    return MomentFigure(figure, axes, scene, overlays, inches, per_mm, arrow, letters, lines)


def _draw_legend(figure: Figure, title: str, handles: Sequence[Line2D | Patch], columns: int) -> None:
    """Write title and legend above the drawing."""
    figure.legend(
        handles=handles, loc="outside upper left", ncols=columns, handletextpad=0.4, handlelength=1.6,
        columnspacing=1.2, title=title, alignment="left", title_fontsize=8,
    )  # fmt: skip


def _choose_scales(found: Sequence[Loads], span: float) -> tuple[float, float]:
    """Return the load that a drawn millimetre stands for (N/mm), and the length of one newton (mm)."""
    load = max(float(np.abs(one.load).max(initial=0.0)) for one in found)
    force = max(abs(one.tip_force) for one in found)
    per_mm = round_up(load / (_MAX_LOAD_FRACTION * span)) if load > 0 else 0.0
    return per_mm, _MAX_FORCE_FRACTION * span / force if force > 0 else 0.0


def _find_limits(points: Floats, span: float) -> tuple[Span, Span]:
    """Return limits of x and y that show all points, and are not too narrow for what is written above."""
    x, y = find_limits(points, _MIN_HEIGHT_RATIO * span)
    more = max(0.0, (y[1] - y[0]) / _MAX_HEIGHT_RATIO - (x[1] - x[0]))
    return (x[0] - more / 2, x[1] + more / 2), y


def _axis_labels(entry: Entry) -> dict[str, str]:
    """Return the labels of the axes: those of C if the scene has no other world."""
    if entry == Entry():
        return {"xlabel": "x along the entry (mm)", "ylabel": "y (mm)"}
    return {"xlabel": "x in the world (mm)", "ylabel": "y in the world (mm)"}


def _collect_points(
    scene: Scene, moments: Sequence[NeedleState], overlays: SceneOverlays, whole: bool
) -> Floats:
    """Return points in the world that a drawing of all these moments must hold, (K, 2) mm."""
    deepest = max(moment.shape.depth for moment in moments)
    start = -scene.needle.length if whole or deepest == 0 else -_MARGIN_BEFORE_ENTRY * deepest
    drawn = [scene.entry.to_world([[0.0, 0.0], [deepest, 0.0]])]
    for moment in moments:
        marks = [(guide.x, guide.y) for guide in moment.step.controls.guides]
        drawn += [trace_needle(scene.entry, moment.shape), scene.entry.to_world(np.reshape(marks, (-1, 2)))]
    points = np.concatenate([*drawn, *map(scene.entry.to_world, overlays.curves)])
    shown: Floats = points[scene.entry.to_frame(points)[:, 0] >= start]
    return shown


def _collect_force_points(
    entry: Entry, moment: NeedleState, found: Loads, per_mm: float, arrow: float
) -> Floats:
    """Return points that a drawing of the forces must hold, (K, 2) mm."""
    ((x, y),) = compute_positions(moment.shape, moment.shape.x[-1:])
    pulled = [(x, y + arrow * found.tip_force)]
    return np.concatenate([outline_load(entry, moment, found, per_mm), entry.to_world(pulled)])


def _make_handles(overlays: SceneOverlays, per_mm: float, guides: bool) -> list[Line2D | Patch]:
    """Return what the legend shows."""
    handles: list[Line2D | Patch] = [
        *make_legend_handles(guides),
        Line2D([], [], label="tip path", **look.PATH),
    ]
    if per_mm:
        handles.append(Patch(label=f"lateral load, {per_mm:g} N/mm to the mm", **look.LOAD))
    if overlays.measured is not None:
        handles.append(Line2D([], [], label="measured", **look.MEASURED))
    if overlays.low is not None:
        handles.append(Patch(label="95 % band", **look.BAND))
    return handles


_NO_OVERLAYS = SceneOverlays()


def draw_moment(
    title: str,
    scene: Scene,
    moment: NeedleState,
    path: Path,
    overlays: SceneOverlays = _NO_OVERLAYS,
    whole: bool | None = None,
) -> None:
    """Draw one state of an insertion to a .pdf, .png or .svg file.

    Parameters
    ----------
    title : str
    scene : Scene
        Needle, entry, rules and names of layers; tissue and inputs are the moment's.
    moment : NeedleState
    path : Path
    overlays : SceneOverlays
    whole : bool, optional
        As of `lay_out_moments`.

    Raises
    ------
    ConfigError
        If the ending of `path` is another one, or its folder does not exist.
    """

    def figure() -> Figure:
        moment_figure = lay_out_moments(title, scene, [moment], overlays, whole)
        paint_moment(moment_figure, moment)
        fit_height(moment_figure.figure)
        return moment_figure.figure

    draw(path, figure)


def paint_moment(moment_figure: MomentFigure, moment: NeedleState) -> None:
    """Draw one state in a figure, in place of an earlier one."""
    axes, scene = moment_figure.axes, replace(moment_figure.scene, tissue=moment.tissue)
    # Only what was drawn is removed: the axes, their limits and the layout stay the same in every frame.
    for old in (*axes.lines, *axes.patches, *axes.texts):
        old.remove()
    draw_layers(axes, scene, moment_figure.inches)
    _draw_overlays(axes, scene.entry, moment_figure.overlays)
    found = compute_state_loads(scene, moment)
    draw_load(axes, outline_load(scene.entry, moment, found, moment_figure.per_mm))
    path = map_beam_points(moment.shape, moment.shape.tip_path)
    axes.plot(*scene.entry.to_world(path).T, zorder=2.5, **look.PATH)
    draw_needle(axes, scene, moment.step, moment.shape)
    draw_tip_force(axes, scene.entry, moment, found.tip_force * moment_figure.arrow)
    lines, tip = describe_moment(scene.entry, moment, found, moment_figure.letters)
    axes.set_title(_pad_lines(lines, moment_figure.lines), loc="left", pad=4)
    axes.set_title(_pad_lines(tip, moment_figure.lines), loc="right", pad=4, color=look.TIP)


def _pad_lines(lines: list[str], count: int) -> str:
    """Return so many lines, the last ones empty."""
    return "\n".join([*lines, *[""] * (count - len(lines))])


def _draw_overlays(axes: Axes, entry: Entry, overlays: SceneOverlays) -> None:
    if overlays.low is not None and overlays.high is not None:
        band = entry.to_world(np.concatenate((overlays.low, overlays.high[::-1])))
        axes.fill(*band.T, zorder=1.5, **look.BAND)
    if overlays.measured is not None:
        measured = entry.to_world(overlays.measured).T
        axes.plot(*measured, zorder=2.8, **look.HALO)
        axes.plot(*measured, zorder=3.5, **look.MEASURED)
