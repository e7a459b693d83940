"""The tip's error on elements of 1 mm, and by the path angle at a constraint spacing of 1 mm."""

import numpy as np
from mechanics_cases import random_bevel, random_tissue

from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import MAX_SLOPE
from needlefit.mechanics.simulate import simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.project.locate import shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.scene import SceneRecord
from solver_checks import NEEDLE

# ---- elements


def measure_mesh(needle, tissue, steps, rules):
    """Return how far the tip moves, mm, on elements eight times shorter."""
    fine = ModelOptions(rules.spacing, rules.element / 8)
    tips = [simulate_steps(needle, tissue, steps, each).tip_lateral for each in (rules, fine)]
    return abs(tips[1] - tips[0])


def measure_shipped_meshes():
    """Return the change of the tip, mm, in each shipped scene."""
    paths = sorted((shipped_folder() / "configs" / "scenes").glob("*.toml"))
    scenes = {path.stem: Scene.from_record(load(path, SceneRecord)) for path in paths}
    return {name: measure_mesh(one.needle, one.tissue, one.steps, one.rules) for name, one in scenes.items()}


def measure_random_meshes(rng, count):
    """Return the change of the tip, mm, in random insertions to 60 mm whose slopes the model is meant for."""
    changes = []
    while len(changes) < count:
        base = Controls(rng.uniform(-1, 1), rng.uniform(-0.01, 0.01))
        tissue = random_tissue(rng, ModelOptions())
        steps = (Step(rng.uniform(15, 60), random_bevel(rng), base),)
        shape = simulate_steps(NEEDLE, tissue, steps)
        if np.max(np.abs(shape.slope)) <= MAX_SLOPE:
            changes.append(measure_mesh(NEEDLE, tissue, steps, ModelOptions()))
    return changes


# ---- constraint spacing, by the path angle

ANGLE, DEPTH_MM = 0.1, 50.0  # rad, mm
SPACINGS_MM = (2.0, 1.0, 0.5, 0.25)
FINEST_MM = 0.0625
#: tissue, and how far the tip may be from its limit at 1 mm, as a fraction
ADVANCED = {
    "uniform, k = 0.66 MPa": (Tissue([0.22], [1.0]), 0.001),
    "uniform, k = 96 MPa": (Tissue([32.0], [1.0]), 0.005),
    "k = 0.66 MPa, from 25 mm on 6.6 MPa": (Tissue([0.22, 2.2], [1.0, 1.0], [25.0]), 0.005),
}
PHANTOM2 = Tissue([0.2, 33.0, 0.2, 33.0], [1.0, -1.0, 1.0, -1.0], [20.0, 28.0, 45.0])


def find_advanced_tip(tissue, spacing):
    """Return the tip's deflection u, mm, by the path angle."""
    rules = ModelOptions(spacing, spacing, tolerance=1e-11, advance="path_angle")
    return float(simulate(NEEDLE, tissue, Bevel(cut_angle=ANGLE), DEPTH_MM, rules=rules).u[-1])


def measure_spacing(tissue):
    """Return the order of the tip's error, and its error at 1 mm over the deflection."""
    fine, finer = (find_advanced_tip(tissue, one) for one in (2 * FINEST_MM, FINEST_MM))
    limit = finer + (finer - fine) / 3  # removes the error of second order
    errors = np.array([abs(find_advanced_tip(tissue, one) / limit - 1) for one in SPACINGS_MM])
    order = np.polyfit(np.log(SPACINGS_MM[-3:]), np.log(errors[-3:]), 1)[0]
    return float(order), float(errors[SPACINGS_MM.index(1.0)])
