"""Draw the schematics of the documentation, and record the animation of its first page.

python docs/figures.py                 writes docs/figures/{needle,frames,cell,layers}.svg
python docs/figures.py --animation     writes docs/figures/steering.{csv,gif} too (a minute)
python docs/figures.py --workbook      fills the example sheets of the workbook that ships
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.style
import numpy as np
import openpyxl
from matplotlib.animation import PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Rectangle
from state_figure import StateFigure, fit_height

from needlefit.datasets.importing.meanings import VALUES
from needlefit.datasets.importing.prepare import WORKBOOK_FILE
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.planning.steered_needle import (
    Change,
    RecordedStep,
    Recording,
    SteeredNeedle,
    make_head,
    write_recording,
)
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.reporting.figures.style import RC_PARAMS
from needlefit.schemas.scene import SceneRecord

FOLDER = Path(__file__).resolve().parent / "figures"
NEEDLE, MEASURED, TISSUE, CUT = "#1f5fa8", "#c4601d", "#e9dcc3", "#a02c2c"
STYLE = {"svg.hashsalt": "needlefit", "font.size": 9, "mathtext.fontset": "cm", "axes.axisbelow": True}


def main() -> None:
    """Write the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--animation", action="store_true", help="record and animate the insertion too")
    parser.add_argument("--workbook", action="store_true", help="fill the workbook that ships")
    options = parser.parse_args()
    if options.workbook:
        fill_workbook()
    with mpl.rc_context(STYLE):
        for draw in (draw_needle, draw_frames, draw_cell, draw_layers):
            figure = Figure(figsize=(6.6, 2.7), layout="constrained")
            draw(figure.add_subplot())
            name = draw.__name__.removeprefix("draw_")
            figure.savefig(FOLDER / f"{name}.svg", metadata={"Date": None}, transparent=False)
    if options.animation:
        animate(*record(FOLDER / "steering.csv"), FOLDER / "steering.gif")


# --- the schematics -------------------------------------------------------------------------------------


def draw_needle(axes: Axes) -> None:
    """Draw what is measured and predicted: a needle, its deflection, and the errors."""
    x, sim, measured = _needle_shapes()
    axes.add_patch(Rectangle((0, -2.2), 24, 4.6, color=TISSUE, lw=0))
    axes.add_patch(Rectangle((24, -2.2), 36, 4.6, color="#dcc9a3", lw=0))
    axes.plot([-22, 0], [0, 0], color=NEEDLE, lw=3, solid_capstyle="butt")
    axes.plot(x, sim, color=NEEDLE, lw=3, label="model", solid_capstyle="butt")
    axes.plot(x[::6], measured[::6], "o", color=MEASURED, ms=4, label="measured (CT)")
    axes.plot([0, 56], [0, 0], color="0.5", lw=0.8, ls="--")
    _arrow(axes, (x[-1] + 1.2, 0), (x[-1] + 1.2, measured[-1]), "deflection", (x[-1] + 2, 0.6))
    _arrow(axes, (x[-1], sim[-1]), (x[-1], measured[-1]), "", None, colour=CUT)
    axes.text(x[-1] - 1, sim[-1] + 0.25, "tip error (TE)", color=CUT, ha="right")
    axes.annotate(
        "in-plane error (IPE):\nmean distance along the needle", (x[36], (sim[36] + measured[36]) / 2),
        (15, 1.25), color=CUT, arrowprops={"arrowstyle": "-", "color": CUT, "lw": 0.8}, ha="center",
    )  # fmt: skip
    axes.text(1, -2.05, "layer 1"), axes.text(25, -2.05, "layer 2")
    axes.annotate("entry", (0, 0), (-9, 0.9), arrowprops={"arrowstyle": "-", "lw": 0.8})
    axes.text(-22, 2.1, "vertical scale exaggerated", color="0.4")
    axes.legend(loc="lower left", frameon=False)
    _finish(axes, (-22, 68), (-2.2, 2.4))


def _needle_shapes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x = np.linspace(0, 53, 61)
    sim = 1.75 * (x / 53) ** 2.2
    return x, sim, 1.35 * (x / 53) ** 2.05 + 0.03 * np.sin(x)


def draw_frames(axes: Axes) -> None:
    """Draw the world W, the constraint frame C at the entry, and the boundary conditions."""
    angle, entry = np.radians(12), np.array([12.0, 3.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x = np.linspace(-30, 45, 120)
    y = np.where(x > 0, 4.2 * (np.maximum(x, 0) / 45) ** 2, 0) + 1.5 * np.where(
        x < -8, ((x + 8) / 22) ** 2, 0
    )
    axes.add_patch(Rectangle((12, -6), 55, 27, color=TISSUE, lw=0))
    needle = entry + np.column_stack((x, y)) @ turn.T
    axes.plot(*needle.T, color=NEEDLE, lw=2.5)
    for tail, head, label in (((0, 0), (14, 0), "$x_C$"), ((0, 0), (0, 7), "$y_C$")):
        start, end = entry + turn @ np.array(tail), entry + turn @ np.array(head)
        _arrow(
            axes,
            start,
            end,
            label,
            end + np.array([0.2, -2.2 if tail == (0, 0) and head[0] else 0.4]),
            colour="k",
            style="->",
        )
    for head, label in (((-15, -6), "$x_W$"), ((-24, 0.5), "$y_W$")):
        _arrow(axes, (-24, -6), head, label, np.array(head) + 0.4, colour="0.35", style="->")
    guide = entry + turn @ np.array([-10, y[np.argmin(abs(x + 10))]])
    axes.plot(
        [guide[0] - 0.4] * 2, [guide[1] - 3.2, guide[1] - 0.7], color="0.3", lw=4, solid_capstyle="butt"
    )
    axes.plot(
        [guide[0] - 0.4] * 2, [guide[1] + 0.7, guide[1] + 3.2], color="0.3", lw=4, solid_capstyle="butt"
    )
    axes.text(guide[0] - 1, guide[1] - 5.2, "guide: $y$ and slope", ha="center")
    axes.text(needle[0, 0] + 1, needle[0, 1] + 3.2, "base: $y$ and slope")
    axes.text(needle[-1, 0] - 4, needle[-1, 1] + 1.6, "tip, depth $D$ (arc length)", ha="right")
    axes.text(14, -5.3, "tissue")
    axes.text(13, 0.4, "first contact: origin of C")
    axes.add_patch(Arc(tuple(entry), 22, 22, theta1=0, theta2=12, lw=0.8))
    axes.plot([entry[0], entry[0] + 13], [entry[1]] * 2, color="0.5", lw=0.7, ls=":")
    _finish(axes, (-26, 68), (-7, 21))


def draw_cell(axes: Axes) -> None:
    """Draw how the next constraint point follows from the tip: one cell of the insertion."""
    x, length = np.linspace(0, 2, 50), 2.0
    u = 0.10 * x**2
    slope = 0.2 * length
    axes.plot(x, u, color=NEEDLE, lw=3)
    for at in (0, 1, 2):
        axes.plot([at, at], [-0.12, 1.75], color="0.75", lw=0.7)
    axes.plot([3, 3], [-0.12, 1.75], color="0.75", lw=0.7)
    axes.plot([0, 1, 2], [-0.02, 0.13, 0.44], "s", color=CUT, ms=5)
    axes.plot([2, 3], [0.4, 0.4 + slope], color=NEEDLE, ls="--", lw=1.2)
    axes.plot([2, 3], [0.4, 0.4 + slope + 0.5], color=CUT, lw=1.5)
    axes.plot([3], [0.4 + slope + 0.5], "s", color=CUT, ms=6)
    _arrow(
        axes,
        (3.06, 0.4 + slope),
        (3.06, 0.9 + slope),
        "$s\\,b$: offset by the bevel",
        (3.12, 1.0),
        colour=CUT,
    )
    axes.text(3.05, 1.36, "$c_m$: next constraint point", color=CUT)
    axes.text(2.52, 0.47, "tangent $u'_{tip}$", color=NEEDLE)
    axes.text(1.98, 0.05, "tip at $x_{m-1}$: $u_{tip}$", ha="right")
    axes.text(0.08, 0.62, "constraint points: the cut so far", color=CUT)
    _arrow(axes, (2, -0.05), (3, -0.05), "$C_{int}$ = 1 mm: one cell", (2.02, -0.17), colour="0.3")
    _finish(axes, (-0.15, 4.4), (-0.22, 1.65))


def draw_layers(axes: Axes) -> None:
    """Draw the foundation: tissue of thickness t on each side, stiffness by layer, the nearest point."""
    for left, width, colour, name in (
        (0, 4.3, TISSUE, "layer 1: $\\mu_1, \\alpha_1$"),
        (4.3, 5, "#dcc9a3", "layer 2: $\\mu_2, \\alpha_2$"),
    ):
        axes.add_patch(Rectangle((left, -1.7), width, 3.6, color=colour, lw=0))
        axes.text(left + 0.15, -1.55, name)
    at = np.arange(0, 9)
    cut = 0.004 * at**2.2 - 0.03
    x = np.linspace(-1.5, 8.3, 100)
    u = np.where(x > 0, 0.011 * np.maximum(x, 0) ** 2, 0) + 0.25
    axes.plot(x, u, color=NEEDLE, lw=3)
    for i, c in zip(at, cut, strict=True):
        axes.plot([max(i - 0.5, 0), i + 0.5 if i < 8 else 8.3], [c, c], color=CUT, lw=1.2)
        axes.plot([i], [c], "s", color=CUT, ms=4)
        deflection = 0.25 + 0.011 * i**2
        _spring(axes, i, c, deflection)
    axes.text(5.2, 1.15, "needle: $u(x)$", color=NEEDLE)
    axes.text(3.3, -0.55, "nearest constraint point: $c(x)$", color=CUT)
    axes.text(8.35, 0.62, "$e = u - c$")
    axes.annotate("", (-0.4, 1.9), (-0.4, 0.25), arrowprops={"arrowstyle": "<->", "lw": 0.8})
    axes.annotate("", (-0.4, -1.7), (-0.4, 0.25), arrowprops={"arrowstyle": "<->", "lw": 0.8})
    axes.text(-0.55, 1.1, "$t$", ha="right"), axes.text(-0.55, -0.8, "$t$", ha="right")
    _finish(axes, (-1.5, 9.3), (-1.7, 1.9))


def _spring(axes: Axes, x: float, low: float, high: float) -> None:
    y = np.linspace(low, high, 13)
    axes.plot(x + 0.07 * np.where(np.arange(13) % 2, 1, -1), y, color="0.45", lw=0.7)


def _arrow(axes: Axes, tail, head, label: str, place, colour: str = "k", style: str = "<->") -> None:  # noqa: ANN001
    line = {"arrowstyle": style, "color": colour, "lw": 1, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", head, tail, arrowprops=line)
    if label:
        axes.text(*place, label, color=colour)


def _finish(axes: Axes, xlim: tuple[float, float], ylim: tuple[float, float]) -> None:
    axes.set(xlim=xlim, ylim=ylim, xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


# --- the animation --------------------------------------------------------------------------------------

TITLE = "Steering through four layers: the bevel turns over twice"
STEPS_PER_S = 5
LEGS = (  # seconds, depth at the end (mm), then what is set before
    (6.0, 40.0, {}),
    (6.0, 70.0, {"bevel_side": -1.0, "base_y_mm": 4.0}),
    (7.0, 105.0, {"bevel_side": 1.0, "base_y_mm": -3.0}),
)


def record(path: Path) -> tuple[Scene, list[NeedleState]]:
    """Record an insertion of 19 s: the bevel turns over twice, the base moves across.

    Return its scene, and the needle at first contact and after every step.
    """
    scene = load(find_file("scene", "figure1"), SceneRecord)
    scene = scene.model_copy(update={"title": TITLE})
    steering = SteeredNeedle(Scene.from_record(scene), 1.0)
    steps = []
    states = [steering.now]
    number, begin, depth, base = 0, 0.0, 0.0, 0.0
    for seconds, end, settings in LEGS:
        target_base = settings.get("base_y_mm", base)
        first = [Change("bevel_side", None, settings["bevel_side"])] if "bevel_side" in settings else []
        count = round(seconds * STEPS_PER_S)
        for n in range(1, count + 1):
            part = n / count
            moved = base + part * (target_base - base), depth + part * (end - depth)
            changes = [*first, *map(Change, ("base_y_mm", "depth_mm"), (None, None), moved)]
            first, number = [], number + 1
            states.append(steering.apply(changes))
            time = round(begin + part * seconds, 3)
            steps.append(RecordedStep(number, time, tuple(changes), steering.now.shape.tip_lateral))
        begin, depth, base = begin + seconds, end, target_base
    write_recording(Recording(make_head("figure1", 1.0, scene), tuple(steps)), path)
    return steering.scene, states


def animate(scene: Scene, states: Sequence[NeedleState], path: Path) -> None:
    """Write the insertion as a GIF at its own speed; its end stays for a second."""
    writer = PillowWriter(fps=STEPS_PER_S)
    with matplotlib.style.context(["default", RC_PARAMS]):
        drawn = StateFigure(TITLE, scene, states)
        FigureCanvasAgg(drawn.figure)
        drawn.paint(states[0])
        fit_height(drawn.figure)
        with mpl.rc_context({"figure.constrained_layout.use": False}):
            # The layout was found once; a new one for each frame would let the axes jump.
            drawn.figure.set_layout_engine(None)
            with writer.saving(drawn.figure, str(path), dpi=110):
                for state in [*states, *states[-1:] * (STEPS_PER_S - 1)]:
                    drawn.paint(state)
                    writer.grab_frame()


# --- the example of the workbook ------------------------------------------------------------------------

DEPTHS_MM = (35, 40, 45, 50, 55, 60, 65, 70)
NOISE_MM, DIRECTION_SD_DEG, SPECIMEN_SD = 0.05, 0.1, 0.03
"""Standard deviations: of a coordinate, of an entry direction, of the logarithm of the moduli of a block."""

ORIGIN_TEXT = (
    "Where the needles come from: measured, example (of this workbook), or synthetic: otherwise simulated"
)
SETUP: dict[str, str | float] = {
    "origin": "example", "title": "Eight needles in gel", "source": "simulated", "license": "CC0",
    "needle length": 150, "diameter": "20G", "inner diameter": 0, "modulus": "nitinol",
    "boundaries": "20", "boundary sd": 0.2, "point sd": NOISE_MM,
    "entry": "first", "entry point": "0,0,0", "pose shift sd": 0.05,
    "pose": "1,0,0", "pose angle sd": DIRECTION_SD_DEG, "bevel": "0,1,0",
}  # fmt: skip


def fill_workbook() -> None:
    """Simulate a needle in each of eight blocks of gel, and write its points to the example sheets."""
    random, book = np.random.default_rng(4), openpyxl.load_workbook(WORKBOOK_FILE)
    for name in ("example points", "example needles", "setup", "example setup"):
        book[name].delete_rows(2, book[name].max_row)
    for what, value in SETUP.items():
        key = what.replace(" ", "_")
        text = (VALUES[key].unit or None, VALUES[key].text) if key in VALUES else (None, ORIGIN_TEXT)
        for name, shown in (("setup", value if what == "origin" else None), ("example setup", value)):
            book[name].append([what, shown, *text])
            if what in (
                "pose",
                "entry point",
                "bevel",
                "boundaries",
            ):  # else a spreadsheet reads 15,30 as 15.3
                book[name].cell(book[name].max_row, 2).number_format = "@"
    for number, depth in enumerate(DEPTHS_MM, start=1):
        side, stiffness = (1, -1)[number % 2], float(np.exp(random.normal(0, SPECIMEN_SD)))
        scene = Scene.from_record(SceneRecord.model_validate({
            "schema": 2, "title": "A block of two gels", "depth_mm": depth,
            "needle": {"length_mm": 150.0, "outer_diameter_mm": 0.908, "youngs_modulus_gpa": 60.0},
            "bevel": {"offset_mm": 0.07, "side": side},
            "layers": [
                {"name": "stiff", "top_mm": 0.0, "mu_pa": 2e6 * stiffness, "alpha": 1.0},
                {"name": "soft", "top_mm": 20.0, "mu_pa": 6e4 * stiffness, "alpha": 1.0},
            ],
        }))  # fmt: skip
        shape = simulate_steps(scene.needle, scene.tissue, scene.steps, scene.rules)
        x, y = compute_positions(shape, np.arange(0.0, depth + 1, 5)).T
        turn, errors = np.radians(random.normal(0, DIRECTION_SD_DEG)), random.normal(0, NOISE_MM, (2, len(x)))
        points = np.column_stack((x, y + turn * x + errors[0], errors[1]))
        for row in np.round(points, 2) + 0.0:
            book["example points"].append([f"n{number}", *map(float, row)])
        book["example needles"].append([f"n{number}", side, depth, f"block {number}", "gel"])
    book.save(WORKBOOK_FILE)


if __name__ == "__main__":
    main()
