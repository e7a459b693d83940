"""Write an animation of an insertion at its own speed."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib.style
from matplotlib.animation import PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg

from needlefit.errors import ConfigError
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState
from needlefit.project.folders import require_folder
from needlefit.reporting.figures.needles import NO_OVERLAYS, SceneOverlays, StateFigure, round_up
from needlefit.reporting.figures.style import RC_PARAMS, fit_height

FRAMES_PER_S = 10
MAX_FRAMES = 210  # frames of an animation; a longer one plays faster, and its title states that
FINAL_FRAMES = 10  # frames for which the end stays, before a GIF begins anew
DOTS_PER_INCH = 110

TimedState = tuple[float, NeedleState]


def animate(
    title: str,
    scene: Scene,
    states: Iterable[TimedState],
    duration: float,
    path: Path,
    overlays: SceneOverlays = NO_OVERLAYS,
) -> None:
    """Write states of an insertion as an animation, .gif; each is shown from its time to that of the
    next.

    Times are in s, increasing; `duration` is the last of them. All else is as of `StateFigure`.
    ConfigError if the ending of `path` is another one, or its folder does not exist.
    """
    require_folder(path)
    suffix = path.suffix.lower()
    if suffix != ".gif":
        raise ConfigError(
            f"cannot write a `{suffix}` file" if suffix else "the file name has no ending",
            where=path,
            expected="a name that ends in .gif",
            fix=f"write to {path.stem or 'needle'}.gif",
        )
    writer = PillowWriter(fps=FRAMES_PER_S)
    needed = duration * FRAMES_PER_S / (MAX_FRAMES - FINAL_FRAMES)
    speed = round_up(needed) if needed > 1 else 1.0
    # the last frames are not before the end
    count = math.ceil(duration * FRAMES_PER_S / speed - 1e-9) + FINAL_FRAMES
    shown = sample_states(states, [n * speed / FRAMES_PER_S for n in range(count)])
    with matplotlib.style.context(["default", RC_PARAMS]):
        drawn = StateFigure(
            title if speed == 1 else f"{title} ({speed:g} times as fast)", scene, shown, overlays
        )
        FigureCanvasAgg(drawn.figure)
        drawn.paint(shown[0])
        fit_height(drawn.figure)
        with matplotlib.rc_context({"figure.constrained_layout.use": False}):
            # The layout was found once; a new one for each frame would let the axes jump.
            drawn.figure.set_layout_engine(None)
            with writer.saving(drawn.figure, str(path), DOTS_PER_INCH):
                for state in shown:
                    drawn.paint(state)
                    writer.grab_frame()


def sample_states(states: Iterable[TimedState], times: Sequence[float]) -> list[NeedleState]:
    """Return the state shown at each of `times`, increasing: the last one that is not later."""
    found: list[NeedleState] = []
    seen: NeedleState | None = None
    for time, state in states:
        while len(found) < len(times) and time > times[len(found)]:
            # Before the first state there is none: the first one is shown.
            found.append(seen or state)
        seen = state
    assert seen is not None
    return found + [seen] * (len(times) - len(found))
