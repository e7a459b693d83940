"""Check that the pose of the entry in the world does not matter: guides and stage move with it."""

import cmath
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.mechanics.scene import Scene, simulate_scene
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.project.load import check
from needlefit.schemas.scene import SceneRecord
from needlefit.verification.cases import require_converged
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst

RANDOM_CASES = 5
_STAGE, _AXIS = 1.0, -2.0  # degrees to the insertion axis, of the stage and of the template


def make_scene(origin: complex, turn: float) -> Scene:
    """Return a scene whose entry is at `origin` (mm, complex: x + i y), turned by `turn` (rad) as a whole."""
    template = origin + (-15 + 0.4j) * cmath.exp(1j * turn)
    angle = math.degrees(turn)
    tables: dict[str, Any] = {
        "schema": SceneRecord.SCHEMA,
        "title": "a template, two layers, the bevel turned over",
        "needle": {"length_mm": 150.0, "outer_diameter_mm": 1.27, "youngs_modulus_gpa": 80.0},
        "bevel": {"offset_mm": 0.15},
        "layers": [
            {"top_mm": 0.0, "mu_pa": 2e5, "alpha": 1.0},
            {"top_mm": 17.3, "mu_pa": 5e6, "alpha": -3.0},
        ],
        "entry": {"x_mm": origin.real, "y_mm": origin.imag, "angle_deg": angle},
        "controls": {"base_y_mm": 1.0, "stage_angle_deg": angle + _STAGE},
        "guides": [
            {"name": "template", "x_mm": template.real, "y_mm": template.imag, "angle_deg": angle + _AXIS}
        ],
        "steps": [{"depth_mm": 20.0}, {"depth_mm": 40.0, "side": -1}],
    }
    return Scene.from_record(check(tables, SceneRecord, "verification"))


def compare_poses(origin: complex, turn: float) -> tuple[float, float]:
    """Return the differences, mm, of a moved scene's shape in C and of its needle in the world."""
    here, there = make_scene(0j, 0.0), make_scene(origin, turn)
    one, other = (require_converged(simulate_scene(each)[-1]) for each in (here, there))
    points = _complex(here.entry.to_world(sample_inserted_points(one)))
    moved = _complex(there.entry.to_world(sample_inserted_points(other)))
    in_world = worst(np.abs(moved - (origin + points * cmath.exp(1j * turn))))
    return worst(np.abs(one.u - other.u)), in_world


def _complex(points: NDArray[np.float64]) -> NDArray[np.complex128]:
    z: NDArray[np.complex128] = points[:, 0] + 1j * points[:, 1]
    return z


def _measure(rng: np.random.Generator) -> CheckOutcome:
    poses = [(complex(*rng.uniform(-200, 200, 2)), float(rng.uniform(-3, 3))) for _ in range(RANDOM_CASES)]
    in_c, in_world = zip(*(compare_poses(*pose) for pose in poses), strict=True)
    return CheckOutcome((worst(in_c), worst(in_world)))


CHECKS = (
    Check(
        Group.SYMMETRIES,
        f"Entry, template and stage moved together, {RANDOM_CASES} random poses",
        (
            Quantity("change of the deflection in its own frame", at_most(1e-7), "mm"),
            Quantity("distance from the needle moved by hand", at_most(1e-7), "mm"),
        ),
        _measure,
    ),
)
