"""Check the needle's points in the plane, and the discretisation error at the tip of the default mesh.

Points have unit speed; how far do they miss what holds the needle? The mesh (h = C_int = 1 mm) is refined,
constraint spacing and everything else stay as they are.
"""

from collections.abc import Callable, Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics import reference
from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.scene import Scene, simulate_scene
from needlefit.mechanics.shape import MAX_MISS_MM, MAX_SLOPE, NeedleShape, compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.scene import SceneRecord
from needlefit.verification.cases import draw_case, draw_schedule, interpolate, require_converged
from needlefit.verification.check import CheckOutcome, Group, Quantity, at_most, define_check, worst

POINT_CASES, RANDOM_CASES = 5, 40
RADIUS_MM = 300.0
REFINEMENT_FACTOR = 8


def measure_shipped_scenes(measure: Callable[[Scene], float]) -> CheckOutcome:
    """Return the largest value of all shipped scenes, NaN if one is, and which scene has it."""
    values = {}
    for path in sorted((shipped_folder() / "configs" / "scenes").glob("*.toml")):
        values[path.stem] = measure(Scene.from_record(load(path, SceneRecord)))
    largest = list(values)[int(np.argmax(list(values.values())))]
    return CheckOutcome((values[largest],), f"{len(values)} scenes; the largest is that of {largest}")


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
    f"{POINT_CASES} random schedules, compiled and reference",
    Quantity("difference of points", at_most(1e-6), "mm"),
)
def points(rng: np.random.Generator) -> CheckOutcome:
    differences = []
    for _ in range(POINT_CASES):
        shape = draw_schedule(rng).shape()
        s = np.union1d(shape.x, rng.uniform(shape.x[0], shape.depth, 100))
        slow = reference.compute_positions(shape, s)
        differences.append(worst(np.abs(compute_positions(shape, s) - slow)))
    return CheckOutcome((worst(differences),))


@define_check(
    Group.GEOMETRY,
    "The shipped scenes at the entry, guides and tracked tip",
    Quantity("integral of u' - sin u' from the base", at_most(MAX_MISS_MM), "mm"),
)
def miss(rng: np.random.Generator) -> CheckOutcome:
    """Compare the drawn needle with its deflection, at the entry and guides that hold it."""

    def measure_miss(shape: NeedleShape, step: Step) -> float:
        at = [0.0, *(guide.x for guide in step.controls.guides if guide.x <= shape.depth)]
        held: Floats = np.array(at if step.controls.tip is None else [*at, shape.depth])
        return worst(np.abs(compute_positions(shape, held)[:, 1] - interpolate(shape, held)))

    def measure(scene: Scene) -> float:
        moments = zip(simulate_scene(scene), scene.steps, strict=True)
        return worst([measure_miss(require_converged(one), step) for one, step in moments])

    return measure_shipped_scenes(measure)


def measure_error(needle: Needle, tissue: Tissue, steps: Sequence[Step], rules: ModelOptions) -> float:
    """Return how far the tip moves, mm, on elements eight times shorter."""
    fine = ModelOptions(rules.spacing, rules.element / REFINEMENT_FACTOR)
    tips = [
        require_converged(simulate_steps(needle, tissue, steps, each)).tip_lateral for each in (rules, fine)
    ]
    return abs(tips[1] - tips[0])


_LARGEST = Quantity("change of the tip, h = 1 to 0.125 mm", at_most(1e-3), "mm")


@define_check(Group.REFINEMENT, "The shipped scenes", _LARGEST)
def scenes(rng: np.random.Generator) -> CheckOutcome:
    return measure_shipped_scenes(lambda one: measure_error(one.needle, one.tissue, one.steps, one.rules))


@define_check(
    Group.REFINEMENT,
    f"{RANDOM_CASES} random insertions, μ = 0.001 to 100 MPa, t = 5 to 80 mm, slopes to {MAX_SLOPE:g}",
    _LARGEST,
    Quantity("median of the same", at_most(1e-4), "mm"),
)
def random_insertions(rng: np.random.Generator) -> CheckOutcome:
    """Draw insertions that the model is meant for: it assumes small slopes."""
    errors = list[float]()
    steep = 0
    while len(errors) < RANDOM_CASES:
        if steep > RANDOM_CASES:
            raise ArithmeticError(f"most insertions are steeper than {MAX_SLOPE:g}")
        case = draw_case(rng)
        if worst(np.abs(case.shape(ModelOptions()).slope)) > MAX_SLOPE:
            steep += 1
            continue
        errors.append(measure_error(case.needle, case.tissue, case.steps, ModelOptions()))
    remark = f"{steep} more drawn whose slopes exceed {MAX_SLOPE:g}"
    return CheckOutcome((worst(errors), float(np.median(errors))), remark)


CHECKS = (circle, points, miss, scenes, random_insertions)
