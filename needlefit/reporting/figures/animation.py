"""Moments of an insertion one after the other, at their own pace: an animation."""

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
from needlefit.reporting.figures.acting import round_up
from needlefit.reporting.figures.moment import paint
from needlefit.reporting.figures.sheet import Beside, Sheet, lay_out
from needlefit.reporting.figures.style import LOOK, snug

RATE = 10
"""Frames a second."""

MOST = 150
"""Frames of an animation; one that would take more goes faster, and says so."""

STAYS = 10
"""Frames for which the end stays, before a GIF begins anew."""

DOTS = 110
"""To the inch."""

_ALONE = Beside()
Timed = tuple[float, NeedleState]


def animate(
    title: str,
    scene: Scene,
    moments: Iterable[Timed],
    duration: float,
    path: Path,
    beside: Beside = _ALONE,
) -> None:
    """Write moments as an animation, .gif or .mp4: each is seen from its time to the next one's.

    Parameters
    ----------
    title : str
    scene : Scene
        As of `draw_moment`.
    moments : iterable of (time, Moment)
        Times in s, increasing.
    duration : float
        The last of these times, s.
    path : Path
    beside : Beside

    Raises
    ------
    ConfigError
        If the ending of `path` is another one, its folder does not exist, or there is no encoder for it.
    """
    writer = _writer(path)
    speed = _speed(duration)
    shown = sampled(moments, _times(duration, speed))
    with matplotlib.style.context(["default", LOOK]):
        said = title if speed == 1 else f"{title} ({speed:g} times as fast)"
        sheet = lay_out(said, scene, shown, beside)
        _settle(sheet, shown[0])
        _film(sheet, shown, writer, path)


def _settle(sheet: Sheet, moment: NeedleState) -> None:
    """Find the layout of a sheet."""
    FigureCanvasAgg(sheet.figure)
    paint(sheet, moment)
    snug(sheet.figure)


def _film(sheet: Sheet, shown: Iterable[NeedleState], writer: AbstractMovieWriter, path: Path) -> None:
    """Write a frame for each moment; nothing moves but what moves, and no frame is laid out again."""
    with matplotlib.rc_context({"figure.constrained_layout.use": False}):
        sheet.figure.set_layout_engine(None)
        with writer.saving(sheet.figure, str(path), DOTS):
            for moment in shown:
                paint(sheet, moment)
                writer.grab_frame()


def sampled(moments: Iterable[Timed], times: Sequence[float]) -> list[NeedleState]:
    """Return what is seen at each of `times`, increasing: the last moment that is not later."""
    found: list[NeedleState] = []
    seen: NeedleState | None = None
    for time, moment in moments:
        while len(found) < len(times) and time > times[len(found)]:
            found.append(seen or moment)
        seen = moment
    assert seen is not None
    return found + [seen] * (len(times) - len(found))


def _speed(duration: float) -> float:
    """Return how many times as fast as it was a recording is shown."""
    needed = duration * RATE / (MOST - STAYS)
    return round_up(needed) if needed > 1 else 1.0


def _times(duration: float, speed: float) -> list[float]:
    """Return the times of the frames, s; the last ones are not before the end."""
    return [n * speed / RATE for n in range(math.ceil(duration * RATE / speed - 1e-9) + STAYS)]


def _writer(path: Path) -> AbstractMovieWriter:
    """Return the encoder for a file of this ending."""
    require_folder(path)
    suffix = path.suffix.lower()
    if suffix == ".gif":
        return PillowWriter(fps=RATE)
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
    return FFMpegWriter(fps=RATE)
