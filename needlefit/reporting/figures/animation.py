"""Write an animation of an insertion at its own speed."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib.style
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg

from needlefit.errors import ConfigError
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState
from needlefit.project.outputs import require_folder
from needlefit.reporting.figures.forces import round_up
from needlefit.reporting.figures.moments import MomentFigure, SceneOverlays, lay_out_moments, paint_moment
from needlefit.reporting.figures.style import RC_PARAMS, fit_height

FRAMES_PER_S = 10
"""Frames a second."""

MAX_FRAMES = 210
"""Frames of an animation; a longer one plays faster, and its title states that."""

FINAL_FRAMES = 10
"""Frames for which the end stays, before a GIF begins anew."""

DOTS_PER_INCH = 110
"""To the inch."""

_NO_OVERLAYS = SceneOverlays()
TimedMoment = tuple[float, NeedleState]


def animate(
    title: str,
    scene: Scene,
    moments: Iterable[TimedMoment],
    duration: float,
    path: Path,
    overlays: SceneOverlays = _NO_OVERLAYS,
) -> None:
    """Write states of an insertion as an animation, .gif or .mp4; each is shown from its time to that of the
    next.

    Parameters
    ----------
    title : str
    scene : Scene
        As of `draw_moment`.
    moments : iterable of (time, NeedleState)
        Times in s, increasing.
    duration : float
        The last of these times, s.
    path : Path
    overlays : SceneOverlays

    Raises
    ------
    ConfigError
        If the ending of `path` is another one, its folder does not exist, or there is no encoder for it.
    """
    writer = _choose_writer(path)
    speed = _choose_speed(duration)
    shown = sample_moments(moments, _frame_times(duration, speed))
    with matplotlib.style.context(["default", RC_PARAMS]):
        summary = title if speed == 1 else f"{title} ({speed:g} times as fast)"
        moment_figure = lay_out_moments(summary, scene, shown, overlays)
        _find_layout(moment_figure, shown[0])
        _write_frames(moment_figure, shown, writer, path)


def _find_layout(moment_figure: MomentFigure, moment: NeedleState) -> None:
    """Find the layout of a sheet."""
    FigureCanvasAgg(moment_figure.figure)
    paint_moment(moment_figure, moment)
    fit_height(moment_figure.figure)


def _write_frames(
    moment_figure: MomentFigure, shown: Iterable[NeedleState], writer: AbstractMovieWriter, path: Path
) -> None:
    """Write a frame for each moment; nothing moves but what moves, and no frame is laid out again."""
    with matplotlib.rc_context({"figure.constrained_layout.use": False}):
        # The layout was found once; a new one for each frame would let the axes jump.
        moment_figure.figure.set_layout_engine(None)
        with writer.saving(moment_figure.figure, str(path), DOTS_PER_INCH):
            for moment in shown:
                paint_moment(moment_figure, moment)
                writer.grab_frame()


def sample_moments(moments: Iterable[TimedMoment], times: Sequence[float]) -> list[NeedleState]:
    """Return the state shown at each of `times`, increasing: the last one that is not later."""
    found: list[NeedleState] = []
    seen: NeedleState | None = None
    for time, moment in moments:
        while len(found) < len(times) and time > times[len(found)]:
            # Before the first moment there is none: the first one is shown.
            found.append(seen or moment)
        seen = moment
    assert seen is not None
    return found + [seen] * (len(times) - len(found))


def _choose_speed(duration: float) -> float:
    """Return how many times as fast as it was a recording is shown."""
    needed = duration * FRAMES_PER_S / (MAX_FRAMES - FINAL_FRAMES)
    return round_up(needed) if needed > 1 else 1.0


def _frame_times(duration: float, speed: float) -> list[float]:
    """Return the times of the frames, s; the last ones are not before the end."""
    return [
        n * speed / FRAMES_PER_S
        for n in range(math.ceil(duration * FRAMES_PER_S / speed - 1e-9) + FINAL_FRAMES)
    ]


def _choose_writer(path: Path) -> AbstractMovieWriter:
    """Return the encoder for a file of this ending."""
    require_folder(path)
    suffix = path.suffix.lower()
    if suffix == ".gif":
        return PillowWriter(fps=FRAMES_PER_S)
    if suffix != ".mp4":
        raise ConfigError(
            f"cannot write a `{suffix}` file" if suffix else "the file name has no ending",
            where=str(path),
            expected="a name that ends in .gif or .mp4",
            fix=f"write to {path.stem or 'needle'}.gif",
        )
    if not FFMpegWriter.isAvailable():
        raise ConfigError(
            "ffmpeg, which encodes .mp4 files, is not found",
            where=str(path),
            expected="the program ffmpeg on the PATH",
            fix=f"install it (Debian: `apt install ffmpeg`), or write to {path.stem}.gif",
        )
    return FFMpegWriter(fps=FRAMES_PER_S)
