"""Check the discretisation error at the tip of the default mesh (h = C_int = 1 mm), by refining the mesh.

Constraint spacing and everything else stay as they are; only the mesh is refined.
"""

from collections.abc import Sequence

import numpy as np

from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import MAX_SLOPE
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.scene import SceneRecord
from needlefit.verification.cases import draw_case, require_converged
from needlefit.verification.check import CheckOutcome, Group, Quantity, at_most, define_check, worst

REFINEMENT_FACTOR = 8
RANDOM_CASES = 40


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
    errors = {}
    for path in sorted((shipped_folder() / "configs" / "scenes").glob("*.toml")):
        scene = Scene.from_record(load(path, SceneRecord))
        errors[path.stem] = measure_error(scene.needle, scene.tissue, scene.steps, scene.rules)
    largest = list(errors)[int(np.argmax(list(errors.values())))]
    return CheckOutcome(
        (worst(list(errors.values())),), f"{len(errors)} scenes; the largest is that of {largest}"
    )


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


CHECKS = (scenes, random_insertions)
