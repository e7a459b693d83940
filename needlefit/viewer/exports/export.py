"""Files to take away, made from a recording: what is seen in the page, and what is known beside it."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from needlefit.viewer.exports.outcome import Outcome, carry_out, duration, timed
from needlefit.viewer.recording.log import read

if TYPE_CHECKING:
    from needlefit.reporting.figures.sheet import Beside

KINDS = {
    "shape.csv": "text/csv",
    "shape.mrk.json": "application/json",
    "picture.svg": "image/svg+xml",
    "picture.png": "image/png",
    "animation.gif": "image/gif",
    "inputs.csv": "text/csv",
}
"""What there is, and its type."""


def export(path: Path, kind: str) -> bytes:
    """Return what one of `KINDS` holds of the recording at `path`, as it stands now.

    Raises
    ------
    ConfigError, DataError
        If the recording is damaged.
    """
    if kind == "inputs.csv":
        return path.read_bytes()
    outcome = carry_out(read(path))
    with TemporaryDirectory() as folder:
        file = Path(folder) / kind
        _WRITERS[kind](outcome, file)
        return file.read_bytes()


def write_table(outcome: Outcome, path: Path) -> None:
    """Write the shape as a table, .csv."""
    from needlefit.reporting.shape_table import write_shape

    write_shape(outcome.scene, outcome.moment, path, outcome.placement)


def write_curve(outcome: Outcome, path: Path) -> None:
    """Write the needle for 3D Slicer, .mrk.json or .ply."""
    from needlefit.reporting.slicer import write_scene

    placement = outcome.placement or outcome.scene.entry.placement
    diameter = outcome.recording.head.scene.needle.outer_diameter_mm
    write_scene(placement, [outcome.moment.shape], path, diameter)


def write_picture(outcome: Outcome, path: Path) -> None:
    """Draw the needle and what is known beside it, .svg, .png or .pdf."""
    from needlefit.reporting.figures.moment import draw_moment

    draw_moment(outcome.title, outcome.scene, outcome.moment, path, _beside(outcome, banded=True))


def write_animation(outcome: Outcome, path: Path) -> None:
    """Draw everything that was done, .gif or .mp4; without a band, which belongs to one moment."""
    from needlefit.reporting.figures.animation import animate

    moments, lasted = timed(outcome.recording), duration(outcome.recording)
    animate(outcome.title, outcome.scene, moments, lasted, path, _beside(outcome, banded=False))


_WRITERS: dict[str, Callable[[Outcome, Path], None]] = {
    "shape.csv": write_table,
    "shape.mrk.json": write_curve,
    "picture.svg": write_picture,
    "picture.png": write_picture,
    "animation.gif": write_animation,
}


def _beside(outcome: Outcome, banded: bool) -> "Beside":
    """Return what was shown beside the needle, if it is still there."""
    from needlefit.reporting.figures.sheet import Beside
    from needlefit.viewer.opening.recorded import open_recorded
    from needlefit.viewer.overlay.band import band

    subject, steering, scene = open_recorded(outcome.recording), outcome.steering, outcome.scene
    points = None if subject.measured is None else subject.measured.points
    found = None
    if banded and subject.spread is not None:
        found = band(
            subject.spread, scene.needle, scene.tissue, steering.course(), scene.rules, steering.first_cell
        )
    if found is None:
        return Beside(points, synthetic=subject.synthetic)
    low, high = (np.column_stack((found.x, edge)) for edge in (found.low, found.high))
    return Beside(points, low, high, subject.synthetic)
