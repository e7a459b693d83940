"""A picture of one moment of an insertion, in true millimetres: the needle and what acts on it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.mechanics.scene import Entry, Scene
from needlefit.mechanics.session import NeedleState
from needlefit.mechanics.shape import map_beam_points
from needlefit.reporting.figures import look
from needlefit.reporting.figures.acting import acting, draw_load, draw_tip_force, profile, told
from needlefit.reporting.figures.sheet import Beside, Sheet, lay_out
from needlefit.reporting.figures.style import draw, snug
from needlefit.reporting.figures.world import draw_layers, draw_needle

_ALONE = Beside()


def draw_moment(
    title: str,
    scene: Scene,
    moment: NeedleState,
    path: Path,
    beside: Beside = _ALONE,
    whole: bool | None = None,
) -> None:
    """Draw one moment, mm in both directions alike, to a .pdf, .png or .svg file.

    Parameters
    ----------
    title : str
    scene : Scene
        Needle, entry, rules and names of layers; tissue and inputs are the moment's.
    moment : Moment
    path : Path
    beside : Beside
    whole : bool, optional
        As of `lay_out`.

    Raises
    ------
    ConfigError
        If the ending of `path` is another one, or its folder does not exist.
    """

    def figure() -> Figure:
        sheet = lay_out(title, scene, [moment], beside, whole)
        paint(sheet, moment)
        snug(sheet.figure)
        return sheet.figure

    draw(path, figure)


def paint(sheet: Sheet, moment: NeedleState) -> None:
    """Paint one moment on a sheet, in place of whatever is on it."""
    axes, scene = sheet.axes, replace(sheet.scene, tissue=moment.tissue)
    for old in (*axes.lines, *axes.patches, *axes.texts):
        old.remove()
    draw_layers(axes, scene, sheet.inches)
    _draw_beside(axes, scene.entry, sheet.beside)
    found = acting(scene, moment)
    draw_load(axes, profile(scene.entry, moment, found, sheet.per_mm))
    path = map_beam_points(moment.shape, moment.shape.tip_path)
    axes.plot(*scene.entry.to_world(path).T, zorder=2.5, **look.PATH)
    draw_needle(axes, scene, moment.step, moment.shape)
    draw_tip_force(axes, scene.entry, moment, found.tip_force * sheet.arrow)
    lines, tip = told(scene.entry, moment, found, sheet.letters)
    axes.set_title(_filled(lines, sheet.lines), loc="left", pad=4)
    axes.set_title(_filled(tip, sheet.lines), loc="right", pad=4, color=look.TIP)


def _filled(lines: list[str], count: int) -> str:
    """Return so many lines, the last ones empty."""
    return "\n".join([*lines, *[""] * (count - len(lines))])


def _draw_beside(axes: Axes, entry: Entry, beside: Beside) -> None:
    if beside.low is not None and beside.high is not None:
        band = entry.to_world(np.concatenate((beside.low, beside.high[::-1])))
        axes.fill(*band.T, zorder=1.5, **look.BAND)
    if beside.measured is not None:
        measured = entry.to_world(beside.measured).T
        axes.plot(*measured, zorder=2.8, **look.HALO)
        axes.plot(*measured, zorder=3.5, **look.MEASURED)
