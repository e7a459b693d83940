"""The files that `simulate` writes of a scene; of a recording `viewer/exports/export.py` does."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from needlefit.mechanics.scene import Scene
    from needlefit.mechanics.shape import NeedleShape

SPEED = 10.0
"""mm/s: how fast a scene goes in in an animation; the model knows no time."""


@dataclass(frozen=True)
class Inserted:
    """A scene carried out, up to the step that failed; `diameter` is the needle's, mm, if it is known."""

    title: str
    scene: "Scene"
    shapes: "tuple[NeedleShape, ...]"
    diameter: float | None


def write_picture(done: Inserted, path: Path) -> None:
    """Draw the needle after each step."""
    from needlefit.reporting.figures.scene import draw_scene

    draw_scene(done.title, done.scene, done.shapes, path)


def write_curves(done: Inserted, path: Path) -> bool:
    """Write the needle for 3D Slicer; False where there is none."""
    from needlefit.reporting.slicer import write_scene

    return write_scene(done.scene.entry.placement, done.shapes, path, done.diameter)


def write_table(done: Inserted, path: Path) -> bool:
    """Write the last shape; False where there is none."""
    from needlefit.mechanics.session import Moment
    from needlefit.reporting.shape_table import write_shape

    shape = done.shapes[-1]
    if shape.converged:
        last = done.scene.steps[len(done.shapes) - 1]
        write_shape(done.scene, Moment(shape, last, done.scene.tissue), path)
    return shape.converged


def write_animation(done: Inserted, path: Path) -> None:
    """Draw the needle on its way, as far as it comes."""
    from needlefit.mechanics.strides import strides
    from needlefit.reporting.figures.animation import animate

    moments = [(gone / SPEED, moment) for gone, moment in strides(done.scene)]
    animate(done.title, done.scene, moments, moments[-1][0], path)
