"""Check the needle's points in the plane, and the discretisation error at the tip of the default mesh.

Points have unit speed; how far do they miss what holds the needle? The mesh (h = C_int = 1 mm) is refined,
constraint spacing and everything else stay as they are.

By the path angle the tip has a limit as C_int shrinks. By the paper's rule C_int is part of the model and no
mesh size: b turns the cut once per C_int, so halving C_int at fixed b turns the needle more often; b halved
with it turns as much per mm, and still does not give the same needle.
"""

from collections.abc import Callable, Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics import reference
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.scene import Scene, simulate_scene
from needlefit.mechanics.shape import MAX_MISS_MM, MAX_SLOPE, NeedleShape, compute_positions
from needlefit.mechanics.simulate import simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.scene import SceneRecord
from needlefit.verification.cases import (
    PAPER_NEEDLE,
    draw_case,
    draw_schedule,
    interpolate,
    make_tissue,
    require_converged,
)
from needlefit.verification.check import (
    AcceptanceBound,
    Check,
    CheckOutcome,
    ConvergenceCurve,
    Group,
    Quantity,
    at_most,
    define_check,
    within,
    worst,
)

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


DEPTH, ANGLE = 50.0, 0.1  # mm, rad
SPACINGS = (2.0, 1.0, 0.5, 0.25)
FINEST = 0.0625
#: k = 3 mu, MPa: how far the tip may be from its limit at C_int = 1 mm, as a fraction
MODULI = {0.66: 0.001, 96.0: 0.005}
#: mm: where tissue of k = 0.66 MPa gives way to tenfold k, and how far the tip may be from its limit then
BOUNDARY, LAYERED_ERROR = 25.0, 0.005
NEARLY = 1e-6  # mm
PLACES = (12.0, 12.5, 30.0)  # mm: at and between constraint points


def find_tip(k: float, spacing: float, depth: float = DEPTH, boundary: float | None = None) -> float:
    """Return the tip's deflection u, mm; behind a boundary the tissue is ten times as stiff."""
    mu = [k / 3] if boundary is None else [k / 3, 10 * k / 3]
    tissue = make_tissue(mu, [1.0] * len(mu), [] if boundary is None else [boundary])
    rules = ModelOptions(spacing, spacing, tolerance=1e-11, advance="path_angle")
    shape = simulate(PAPER_NEEDLE, tissue, Bevel(cut_angle=ANGLE), depth, rules=rules)
    return float(require_converged(shape).u[-1])


def _order(k: float, allowed: float, boundary: float | None = None) -> Check:
    layered = "" if boundary is None else f" and, from {boundary:g} mm on, tenfold k"

    def measure(rng: np.random.Generator) -> CheckOutcome:
        # the error of the finest one is removed as an order of two has it
        fine, finer = (find_tip(k, one, boundary=boundary) for one in (2 * FINEST, FINEST))
        limit = finer + (finer - fine) / 3
        errors = tuple(abs(find_tip(k, spacing, boundary=boundary) / limit - 1) for spacing in SPACINGS)
        curve = ConvergenceCurve(f"path angle, k = {k:g} MPa{layered}", SPACINGS, {"tip": errors})
        return CheckOutcome((curve.order("tip"), errors[SPACINGS.index(1.0)]), curves=(curve,))

    return Check(
        Group.PATH_ANGLE,
        f"The tip in tissue of k = {k:g} MPa{layered}, {DEPTH:g} mm deep, C_int = 2 to 0.25 mm",
        (
            Quantity("order of its error", within(2.0, 0.25), ""),
            Quantity("error at C_int = 1 mm over the deflection", at_most(allowed), ""),
        ),
        measure,
    )


@define_check(
    Group.PATH_ANGLE,
    "Long uniform tissue of k = 96 MPa",
    Quantity("curvature over θ β, less 1", at_most(0.01), ""),
)
def curvature(rng: np.random.Generator) -> CheckOutcome:
    k = 96.0
    beta = (k / 4 / PAPER_NEEDLE.flexural_rigidity) ** 0.25
    rules = ModelOptions(advance="path_angle")
    shape = simulate(PAPER_NEEDLE, make_tissue([k / 3], [1.0]), Bevel(cut_angle=ANGLE), 120.0, rules=rules)
    middle = slice(-60, -50)
    turns = np.diff(require_converged(shape).slope)[middle] / np.diff(shape.x)[middle]
    return CheckOutcome((worst(np.abs(turns / (ANGLE * beta) - 1)),))


@define_check(
    Group.PATH_ANGLE,
    "Depth, and a boundary before tenfold k, moved by 1e-6 mm at and between constraint points",
    Quantity("change of the tip by the depth", at_most(1e-5), "mm"),
    Quantity("change of the tip by the boundary", at_most(1e-5), "mm"),
)
def continuity(rng: np.random.Generator) -> CheckOutcome:
    deeper = [find_tip(0.66, 1.0, at + NEARLY) - find_tip(0.66, 1.0, at) for at in (*PLACES, DEPTH)]
    shifted = [find_tip(0.66, 1.0, boundary=at + NEARLY) - find_tip(0.66, 1.0, boundary=at) for at in PLACES]
    return CheckOutcome((worst(np.abs(deeper)), worst(np.abs(shifted))))


OFFSET = 0.085


@define_check(
    Group.STATED,
    "The tip in four layers of the paper’s values, 50 mm deep",
    Quantity(f"deflection, C_int = 1 mm, b = {OFFSET:g} mm", AcceptanceBound(), "mm"),
    Quantity(f"deflection, C_int = 0.5 mm, b = {OFFSET:g} mm", AcceptanceBound(), "mm"),
    Quantity(f"deflection, C_int = 0.5 mm, b = {OFFSET / 2:g} mm", AcceptanceBound(), "mm"),
)
def tips(rng: np.random.Generator) -> CheckOutcome:
    tissue = make_tissue([0.2, 33.0, 0.2, 33.0], [1.0, -1.0, 1.0, -1.0], [20.0, 28.0, 45.0])

    def tip(spacing: float, offset: float) -> float:
        rules = ModelOptions(spacing, spacing)
        return require_converged(
            simulate(PAPER_NEEDLE, tissue, Bevel(offset), DEPTH, rules=rules)
        ).tip_lateral

    return CheckOutcome((tip(1.0, OFFSET), tip(0.5, OFFSET), tip(0.5, OFFSET / 2)))


CHECKS = (
    *(circle, points, miss, scenes, random_insertions),
    *(_order(*one) for one in MODULI.items()),
    _order(0.66, LAYERED_ERROR, BOUNDARY),
    *(curvature, continuity, tips),
)
