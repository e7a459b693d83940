"""Check the needle's points in the plane: unit speed, and how far they miss what holds the needle."""

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics import reference
from needlefit.mechanics.control import Controls
from needlefit.mechanics.scene import Scene, simulate_scene
from needlefit.mechanics.shape import MAX_MISS_MM, NeedleShape, compute_positions
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.scene import SceneRecord
from needlefit.verification.cases import draw_schedule, interpolate, require_converged
from needlefit.verification.check import CheckOutcome, Group, Quantity, at_most, define_check, worst

RANDOM_CASES = 5
RADIUS_MM = 300.0


@define_check(
    Group.GEOMETRY,
    f"A needle of constant u'' = 1 / {RADIUS_MM:g} mm",
    Quantity("distance from the circle", at_most(1e-9), "mm"),
)
def circle(rng: np.random.Generator) -> CheckOutcome:
    """A deflection of constant u'' is exact in cubic elements, and is a circle of that curvature."""
    x = np.concatenate(([-95.0, -20.0], np.arange(56.0)))
    along = x + 95.0
    still = np.zeros((1, 2))
    shape = NeedleShape(x, along**2 / 2 / RADIUS_MM, along / RADIUS_MM, still, still, "converged", 0)
    place = compute_positions(shape, np.linspace(x[0], x[-1], 301))
    radii = np.hypot(place[:, 0] + 95.0, place[:, 1] - RADIUS_MM)
    return CheckOutcome((worst(np.abs(radii - RADIUS_MM)),))


@define_check(
    Group.GEOMETRY,
    f"{RANDOM_CASES} random schedules, compiled and reference",
    Quantity("difference of points", at_most(1e-6), "mm"),
)
def points(rng: np.random.Generator) -> CheckOutcome:
    differences = []
    for _ in range(RANDOM_CASES):
        shape = draw_schedule(rng).shape()
        s = np.union1d(shape.x, rng.uniform(shape.x[0], shape.depth, 100))
        slow = reference.compute_positions(shape, s)
        differences.append(worst(np.abs(compute_positions(shape, s) - slow)))
    return CheckOutcome((worst(differences),))


def measure_miss(shape: NeedleShape, controls: Controls) -> float:
    """Return how far the drawn needle is from its deflection at the entry and guides that hold it, mm."""
    at = [0.0, *(guide.x for guide in controls.guides if guide.x <= shape.depth)]
    held: Floats = np.array(at if controls.tip is None else [*at, shape.depth])
    return worst(np.abs(compute_positions(shape, held)[:, 1] - interpolate(shape, held)))


@define_check(
    Group.GEOMETRY,
    "The shipped scenes at the entry, guides and tracked tip",
    Quantity("integral of u' - sin u' from the base", at_most(MAX_MISS_MM), "mm"),
)
def miss(rng: np.random.Generator) -> CheckOutcome:
    misses = {}
    for path in sorted((shipped_folder() / "configs" / "scenes").glob("*.toml")):
        scene = Scene.from_record(load(path, SceneRecord))
        moments = zip(simulate_scene(scene), scene.steps, strict=True)
        misses[path.stem] = worst(
            [measure_miss(require_converged(one), step.controls) for one, step in moments]
        )
    largest = max(misses, key=lambda name: misses[name])
    return CheckOutcome((misses[largest],), f"{len(misses)} scenes; the largest is that of {largest}")


CHECKS = (circle, points, miss)
