"""The needle of the animation in its layers, with its forces, in the constraint frame C."""

import math
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.interpolate import BSpline

sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))

from needle_loads import Loads, compute_loads, map_beam_points

from needlefit.arrays import Floats
from needlefit.mechanics.control import Controls, Step
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.mechanics.torsion import find_roll
from needlefit.reporting.figures.style import choose_vertical_scale
from needlefit.reporting.labels import GREY, INK
from needlefit.reporting.number_format import format_quantity

COLOURS = {
    **{"ink": "#1a1a1a", "needle": "#4b5158", "points": "#b84f00", "path": "#0a2f4a", "tip": "#c8102e"},
    **{"guide": "#007a58", "load": "#a2457b"},
}
"""Colours of the page of `needlefit view` in its light theme, by the names in its style sheet."""

_LOOKS: dict[str, dict[str, Any]] = {
    "base": {"color": COLOURS["ink"], "marker": "o", "ms": 5.0, "lw": 0},
    "guide": {"color": COLOURS["guide"], "marker": "o", "ms": 5.0, "mec": "white", "mew": 0.5, "lw": 0},
    "points": {"color": COLOURS["points"], "marker": "x", "ms": 2.8, "mew": 0.6, "lw": 0},
    "tip": {"color": COLOURS["tip"], "marker": "o", "ms": 4.0, "mec": "white", "mew": 0.4, "lw": 0},
    "needle": {"color": COLOURS["needle"], "lw": 1.4},
    "path": {"color": COLOURS["path"], "lw": 0.9},
    "load": {"fc": to_rgba(COLOURS["load"], 0.32), "ec": COLOURS["load"], "lw": 0.5},
}
_LAYER_COLOURS = LinearSegmentedColormap.from_list("layers", ["#f7f4ee", "#d3c7ae"])
Span = tuple[float, float]

_NAMES_IN_C = ("x along the entry (mm)", "y (mm)")
_SEPARATOR = "  ·  "
_BEYOND_PANEL_MM = 1e4  # further than any panel reaches
_MARGIN_BEFORE_ENTRY = 0.22  # share of the depth shown before the entry, where only what is inserted is shown
_LETTER_WIDTH_IN = 0.06  # of 7.5 point type
# Inches, of 6.5 point type.
_LABEL_LETTER_IN = 0.055  # mean width of a letter
_LABEL_MARGIN_IN = 0.05  # beside a label
_MODULUS_WIDTH_IN = 0.58  # of a modulus with its unit


# ---- layers and needle of a panel


def label_layers(scene: Scene, widths: Mapping[int, float]) -> dict[int, str]:
    """Return the labels of the layers (counted from 0) that are wide enough on paper, in inches.

    All of them are called in the same way: by the scene's own names if these fit, or "layer 1", or "1". Its
    modulus stands below, where a layer has room for it.
    """
    numbered = {i: f"layer {i + 1}" for i in widths}
    layer_labels = {
        i: (scene.layer_names[i] if scene.layer_names else "") or called for i, called in numbered.items()
    }
    labels = {i: f"{i + 1}" for i in widths}
    for names in (layer_labels, numbered):
        if all(_LABEL_LETTER_IN * len(name) + _LABEL_MARGIN_IN <= widths[i] for i, name in names.items()):
            labels = names
            break
    for i, name in labels.items():
        if widths[i] > _MODULUS_WIDTH_IN:
            labels[i] = f"{name}\n{format_quantity('mu_pa', scene.tissue.mu[i] * 1e6)}"
    return labels


def _trace(shape: NeedleShape) -> Floats:
    """Return points of the needle from base to tip, (300, 2) mm."""
    return compute_positions(shape, np.linspace(shape.x[0], shape.depth, 300))[:, :2]


def _find_guides(step: Step) -> Floats:
    """Return the places of the guides in C, (G, 2) mm."""
    places = [(guide.x, guide.y) for guide in step.controls.guides]
    return np.reshape(np.array(places, dtype=np.float64), (-1, 2))


def _draw_layers(axes: Axes, scene: Scene, scale: float) -> None:
    """Shade the layers, the darker the stiffer, and label them; `scale` in inches per mm."""
    stiffness = np.log10(scene.tissue.mu)
    decades = max(float(np.ptp(stiffness)), 1.0)  # one at least, so that like layers look alike
    edges = np.array([0.0, *scene.tissue.boundaries, _BEYOND_PANEL_MM])
    for i, (top, bottom) in enumerate(pairwise(edges)):
        shade = _LAYER_COLOURS(float((stiffness[i] - stiffness.min()) / decades))
        axes.axvspan(top, bottom, color=shade, lw=0, zorder=0)
        axes.axvline(top, color="white" if i else INK, lw=1.2 if i else 0.6, zorder=0.5)
    axes.axhline(0.0, color=GREY, lw=0.5, ls=(0, (4, 3)), zorder=1)
    shown = np.clip(edges, *axes.get_xlim())
    room = dict(enumerate(np.diff(shown).tolist()))
    least = 0.03 * (shown[-1] - axes.get_xlim()[0])
    widths = {i: width * scale for i, width in room.items() if width > least}
    for i, label in label_layers(scene, widths).items():
        axes.text(
            (shown[i] + shown[i + 1]) / 2, 0.05, label, transform=axes.get_xaxis_transform(), fontsize=6.5,
            linespacing=1.3, ha="center", va="bottom",
        )  # fmt: skip


def _draw_needle(axes: Axes, scene: Scene, step: Step, shape: NeedleShape) -> None:
    """Draw a needle, its constraint points and its supports; or the reason why there is no needle."""
    for guide in _find_guides(step):
        axes.plot(*guide, zorder=5, **_LOOKS["guide"])
    base, stage = step.controls.base[0], step.controls.base[2]  # known without a solution
    axes.plot(step.depth - scene.needle.length, base + stage * step.depth, zorder=5, **_LOOKS["base"])
    if not shape.converged:
        axes.text(
            0.5, 0.7, f"no solution: {shape.status}", transform=axes.transAxes, ha="center", va="center",
            zorder=6, fontsize=8.5, color=COLOURS["tip"],
            bbox={"fc": "white", "alpha": 0.7, "lw": 0, "pad": 2},
        )  # fmt: skip
        return
    places = map_beam_points(shape, shape.constraints)[:, :2]
    axes.plot(*places.T, zorder=2, **_LOOKS["points"])
    needle = _trace(shape)
    axes.plot(*needle.T, zorder=3, **_LOOKS["needle"])
    axes.plot(*needle[-1], zorder=6, **_LOOKS["tip"])


def _draw_legend(
    figure: Figure, title: str, supports: Mapping[str, str], more: Sequence[Line2D | Patch], columns: int
) -> None:
    """Write title and legend above the panels; `supports` are shown beside what every needle has."""
    marks = {**supports, "points": "constraint points", "tip": "tip"}
    handles = [Line2D([], [], label=label, **_LOOKS[name]) for name, label in marks.items()]
    figure.legend(
        handles=[*handles, *more], loc="outside upper left", ncols=columns, columnspacing=1.2, borderpad=0.3,
        handletextpad=0.4 if more else 0.2, handlelength=1.6 if more else None, alignment="left",
        title=title, title_fontsize=8,
    )  # fmt: skip


# ---- what stands above a panel


def _replace_minus(text: str) -> str:
    return text.replace("-", "−")


def _format_signed(value: float) -> str:
    text = _replace_minus(f"{value:+z.2f}".rstrip("0").rstrip("."))
    return "0" if text in ("+0", "−0") else text


def describe_inputs(step: Step) -> list[str]:
    """Return a description of the bevel, and of what holds the needle elsewhere than on the entry's axis."""
    held = step.controls
    side = f"bevel {'left' if step.bevel.side > 0 else 'right'}"
    if step.bevel.roll_deg % 180:
        side = f"bevel rolled by {_format_signed(find_roll(step.bevel))}°"
    parts = [side]
    if held.base_y or held.base_slope:
        angle = f", {_format_signed(np.degrees(np.arctan(held.base_slope)))}°" if held.base_slope else ""
        parts.append(f"base {_format_signed(held.base_y)} mm{angle}")
    if held.tip is not None:
        parts.append(f"tip tracked at {_format_signed(held.tip.y)} mm")
    return parts


def describe_state(state: NeedleState, loads: Loads, letters: int) -> tuple[list[str], list[str]]:
    """Return the text above a drawing: position and supports of the needle in lines of so many letters; its
    tip.
    """
    step = state.step

    def force(name: str, newton: float) -> str:
        return _replace_minus(f"{name} {newton:+z.3f} N")

    position = [f"{step.depth:.4g} mm deep", *describe_inputs(step)]
    bevel = step.bevel  # how strongly it turns the cut: its offset b, or the angle of its cut
    angle, offset = f"θ {math.degrees(bevel.cut_angle):.3g}°", f"b {bevel.offset:.3g} mm"
    position.append(angle if bevel.cut_angle else offset)
    supports = [f"{force('base', loads.base.force)}, {_replace_minus(f'{loads.base.moment:+z.2f}')} N mm"]
    for n, (guide, held) in enumerate(zip(step.controls.guides, loads.guides, strict=True), start=1):
        supports.append(force(guide.name or f"guide {n}", held.force))
    lines = [line for part in (position, supports) for line in textwrap.wrap(_SEPARATOR.join(part), letters)]
    return lines, [_replace_minus(f"tip {state.shape.tip_lateral:+z.2f} mm")]


def _pad_lines(lines: Sequence[str], count: int) -> str:
    return "\n".join([*lines, *[""] * (count - len(lines))])


# ---- one state with its forces, in C

# Of the drawing's height.
_MAX_LOAD_FRACTION = 0.2  # the largest load
_ROOM_FRACTION = 0.6  # of the needle's height above and below it, for loads and what is written
_MIN_BEND_FRACTION = 0.01  # of the depth: smaller deflections are not exaggerated further
_MAX_HEIGHT_RATIO = 1.1  # height of a panel over its width
_AXES_IN = 0.6  # inches beside the panel
_TIP_TEXT_WIDTH_IN = 1.5  # inches, of the text on the tip
_LEGEND_COLUMN_WIDTH_IN = 1.35  # inches, on an average
PRINT_WIDTH_IN = 174 / 25.4  # inches, of both columns of a paper


class StateFigure:
    """A figure with axes in C that has room for each of some states of an insertion.

    Of the scene it has needle, rules and names of layers; tissue and inputs are those of a state. The needle
    is drawn from its base on where more than the bevel steers it, else from the entry on; y is drawn as many
    times as large as x as its label states. `per_mm` is the lateral load per drawn millimetre of y, N/mm
    (0 without a load).
    """

    def __init__(self, title: str, scene: Scene, states: Sequence[NeedleState]) -> None:
        self._scene = scene
        loads = [self._compute_loads(state) for state in states]
        x, y, factor = self._choose_view(states)
        self._height_mm = y[1] - y[0]
        load = max(float(np.abs(self._smooth(load)).max(initial=0.0)) for load in loads)
        self.per_mm = round_up(load / (_MAX_LOAD_FRACTION * self._height_mm)) if load > 0 else 0.0
        width = PRINT_WIDTH_IN - _AXES_IN
        self._inches = width / (x[1] - x[0])
        height = self._inches * factor * self._height_mm
        # room for the text above the drawing, beside the text on the tip
        self._letters = int((width - _TIP_TEXT_WIDTH_IN) / _LETTER_WIDTH_IN)
        texts = [describe_state(*pair, self._letters)[0] for pair in zip(states, loads, strict=True)]
        self._lines = max(2, *map(len, texts))
        more_handles = self._list_handles()
        supports = {"base": "base"}
        if any(state.step.controls.guides for state in states):
            supports["guide"] = "guide or template"
        columns = max(int(width / _LEGEND_COLUMN_WIDTH_IN), 2)
        legend_lines = math.ceil((len(supports) + 2 + len(more_handles)) / columns)
        times = "" if factor == 1 else f", drawn {factor:g}× as large as x"
        x_name, y_name = _NAMES_IN_C[0], f"{_NAMES_IN_C[1]}{times}"
        tall = height + 0.75 + 0.14 * (self._lines + legend_lines)
        self.figure = Figure(figsize=(width + _AXES_IN, tall))
        self.axes = self.figure.add_subplot(xlabel=x_name)
        short = len(y_name) * _LETTER_WIDTH_IN > height
        self.axes.set(xlim=x, ylim=y, aspect=factor, ylabel=y_name.replace(", ", ",\n") if short else y_name)
        letters = int(width / _LETTER_WIDTH_IN)
        _draw_legend(self.figure, textwrap.fill(title, letters), supports, more_handles, columns)

    def paint(self, state: NeedleState) -> None:
        """Draw one state, in place of an earlier one."""
        axes, scene = self.axes, replace(self._scene, tissue=state.tissue)
        # Only what was drawn is removed: the axes, their limits and the layout stay the same in every frame.
        for axis in self.figure.axes:
            for old in (*axis.lines, *axis.patches, *axis.texts):
                old.remove()
        _draw_layers(axes, scene, self._inches)
        path = map_beam_points(state.shape, state.shape.tip_path)
        axes.plot(*path[:, :2].T, zorder=2.5, **_LOOKS["path"])
        _draw_needle(axes, scene, state.step, state.shape)
        loads = self._compute_loads(state)
        if len(outline := self._outline_load(state, loads)):
            axes.fill(*outline.T, zorder=1.8, **_LOOKS["load"])
        lines, tip = describe_state(state, loads, self._letters)
        axes.set_title(_pad_lines(lines, self._lines), loc="left", pad=4)
        axes.set_title(_pad_lines(tip, self._lines), loc="right", pad=4, color=COLOURS["tip"])

    def _compute_loads(self, state: NeedleState) -> Loads:
        scene = self._scene
        return compute_loads(state.shape, state.tissue, scene.needle, state.step.controls, scene.rules)

    def _smooth(self, loads: Loads) -> Floats:
        if len(loads.s) < 2:
            return loads.load
        return smooth_load(loads.s, loads.load, self._scene.rules.spacing)

    def _list_handles(self) -> list[Line2D | Patch]:
        """Return the handles of the legend for what is drawn beside the needle."""
        handles: list[Line2D | Patch] = [Line2D([], [], label="tip path", **_LOOKS["path"])]
        if self.per_mm:
            label = f"load, {self.per_mm:g} N/mm to 1 mm of y"
            handles.append(Patch(label=label, **_LOOKS["load"]))
        return handles

    def _choose_view(self, states: Sequence[NeedleState]) -> tuple[Span, Span, float]:
        """Return limits, mm, that hold all these states and their guides, and the scale of y."""
        deepest = max(state.shape.depth for state in states)
        whole = deepest == 0 or any(state.step.controls != Controls() for state in states)
        traces = [_trace(state.shape) for state in states]
        guides = [_find_guides(state.step) for state in states]
        points = np.concatenate([*traces, *guides, np.zeros((1, 2))])
        start = float(points[:, 0].min()) if whole else -_MARGIN_BEFORE_ENTRY * deepest
        across = points[points[:, 0] >= start, 1]
        least = _MIN_BEND_FRACTION * max(deepest, 1.0)
        low, high = float(across.min()), float(across.max())
        room = _ROOM_FRACTION * max(high - low, least)
        x = (start - 0.03 * (deepest - start) * whole, max(1.04 * deepest, 5.0))
        y = min(low, 0.0) - room, max(high, 0.0) + room
        factor = choose_vertical_scale(x[1] - x[0], y[1] - y[0])
        # of a needle that bends more than it is long
        spare = (y[1] - y[0]) / _MAX_HEIGHT_RATIO - (x[1] - x[0])
        return (x[0], x[1] + max(spare, 0.0)), y, factor

    def _outline_load(self, state: NeedleState, loads: Loads) -> Floats:
        """Return the outline of the load along the shaft: from the needle to it, and back."""
        if len(loads.s) == 0 or self.per_mm == 0:
            return np.empty((0, 2))
        needle = compute_positions(state.shape, loads.s)[:, :2]
        pulled = needle + np.column_stack((np.zeros(len(needle)), self._smooth(loads) / self.per_mm))
        return np.concatenate((needle, pulled[::-1]))


def smooth_load(s: Floats, load: Floats, reach: float) -> Floats:
    """Return the mean of a load (K,) over `reach` mm to either side of each of its places, less at the ends.

    Between constraint points the load of the model is a sawtooth; its mean over two spacings is what the
    tissue means to the shaft.
    """
    half = np.minimum(reach, np.minimum(s - s[0], s[-1] - s))
    total = BSpline([s[0], *s, s[-1]], load, 1).antiderivative()  # of the line through the points
    inside = half > 0
    return np.where(inside, (total(s + half) - total(s - half)) / np.where(inside, 2 * half, 1.0), load)


def fit_height(figure: Figure) -> None:
    """Set a figure's height to that of its contents; axes of fixed aspect may not fill it."""
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
    margin = 0.04  # inches, as the layout leaves at the sides
    figure.set_figheight(figure.get_tightbbox().height + 2 * margin)


def round_up(value: float) -> float:
    """Return the smallest of 1, 2, 5, 10, ... (times any power of ten) not less than a positive value."""
    ten = 10.0 ** math.floor(math.log10(value))
    return next(float(f"{step * ten:.1g}") for step in (1, 2, 5, 10) if step * ten >= value * (1 - 1e-9))
