"""Check symmetries of the model, balance of forces, and that the pose of the entry does not matter."""

import cmath
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from needlefit.mechanics.control import Bevel, Controls, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import make_lattice
from needlefit.mechanics.scene import Scene, simulate_scene
from needlefit.mechanics.session import Session
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.mechanics.simulate import compute_loads
from needlefit.mechanics.tissue import Tissue
from needlefit.project.toml import check
from needlefit.schemas.scene import SceneRecord
from needlefit.verification.cases import (
    EXACT_OPTIONS,
    Draw,
    RandomCase,
    draw_case,
    draw_schedule,
    largest_difference,
    require_converged,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, define_check, worst

RANDOM_CASES, RANDOM_POSES = 10, 5


@define_check(
    Group.SYMMETRIES,
    "Tissue, base, guides and tracked tip balance, schedules of all inputs",
    Quantity(f"sum of forces over their sizes, {RANDOM_CASES} random cases", at_most(1e-5), ""),
    Quantity(f"sum of moments over their sizes, {RANDOM_CASES} random cases", at_most(1e-5), ""),
)
def balance(rng: np.random.Generator) -> CheckOutcome:
    """Compare the sum of all forces, and of all moments about the entry, with the sum of their sizes."""

    def sum_over_sizes(values: list[float]) -> float:
        return abs(sum(values)) / float(np.sum(np.abs(values)))

    forces, moments = [], []
    for _ in range(RANDOM_CASES):
        case = draw_schedule(rng)
        found = compute_loads(case.shape(), case.tissue, case.needle, case.steps[-1].controls, EXACT_OPTIONS)
        forces.append(sum_over_sizes([held.force for held in found.all_loads]))
        moments.append(sum_over_sizes([held.moment + held.x * held.force for held in found.all_loads]))
    return CheckOutcome((worst(forces), worst(moments)))


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
    points, moved = (
        scene.entry.to_world(sample_inserted_points(shape)) @ [1, 1j]
        for scene, shape in ((here, one), (there, other))
    )
    in_world = worst(np.abs(moved - (origin + points * cmath.exp(1j * turn))))
    return worst(np.abs(one.u - other.u)), in_world


@define_check(
    Group.SYMMETRIES,
    f"Entry, template and stage moved together, {RANDOM_POSES} random poses",
    Quantity("change of the deflection in its own frame", at_most(1e-7), "mm"),
    Quantity("distance from the needle moved by hand", at_most(1e-7), "mm"),
)
def poses(rng: np.random.Generator) -> CheckOutcome:
    drawn = [(complex(*rng.uniform(-200, 200, 2)), float(rng.uniform(-3, 3))) for _ in range(RANDOM_POSES)]
    in_c, in_world = zip(*(compare_poses(*pose) for pose in drawn), strict=True)
    return CheckOutcome((worst(in_c), worst(in_world)))


def mirrored(case: RandomCase) -> float:
    """Return the difference, mm, of the needle from its mirror image with bevel and base mirrored."""

    def mirror(step: Step) -> Step:
        held = Controls(-step.controls.base_y, -step.controls.base_slope)
        return Step(step.depth, Bevel(step.bevel.offset, -step.bevel.side), held)

    one, other = case.shape(), replace(case, steps=tuple(map(mirror, case.steps))).shape()
    return worst(np.abs(one.u + other.u))


def doubled(case: RandomCase) -> float:
    """Return the difference, mm, if EI and all mu are doubled: forces have no unit of their own."""
    needle = Needle(case.needle.length, 2 * case.needle.flexural_rigidity)
    tissue = replace(case.tissue, mu=2 * case.tissue.mu)
    return largest_difference(case.shape(), RandomCase(needle, tissue, case.steps).shape())


def cut_in_two(case: RandomCase) -> float:
    """Return the difference, mm, if a layer is divided into two equal ones; only the quadrature changes."""
    tissue = case.tissue
    edges = np.array([0.0, *tissue.boundaries, case.steps[-1].depth])
    widest = int(np.argmax(np.diff(edges)))
    cut = edges[widest] + 0.41 * (edges[widest + 1] - edges[widest])
    mu, shape, thickness, friction = (
        np.insert(values, widest, values[..., widest], axis=-1)
        for values in (tissue.mu, tissue.shape, tissue.thickness, tissue.friction)
    )
    boundaries = np.insert(tissue.boundaries, widest, cut)
    halves = Tissue(mu, shape, boundaries, thickness, friction, tissue.law)
    return largest_difference(case.shape(), replace(case, tissue=halves).shape())


def in_pieces(case: RandomCase) -> float:
    """Return the difference, mm, if the insertion halts on the way, at constraint points or between them."""
    whole = case.steps[0]
    halts = [replace(whole, depth=whole.depth * part) for part in (0.123, 0.25, 0.251, 0.5, 0.875)]
    return _against(case, (*halts, whole))


def there_and_back(case: RandomCase) -> float:
    """Return the difference, mm, if the insertion goes too far and back, and back and in again."""
    whole = case.steps[0]
    way = (whole.depth, whole.depth + 0.3, whole.depth, whole.depth - 3.7, whole.depth)
    return _against(case, tuple(replace(whole, depth=depth) for depth in way))


def one_by_one(case: RandomCase) -> float:
    """Return the difference, mm, of a session driven step by step from the whole schedule; it must be 0."""
    first = case.steps[0]
    lattice = make_lattice(case.steps, EXACT_OPTIONS)
    session = Session(
        case.needle, case.tissue, first.bevel, lattice.first_cell, first.controls, EXACT_OPTIONS
    )
    shapes = [require_converged(session.go(step)) for step in case.steps]
    return worst(np.abs(shapes[-1].u - case.shape().u))


def _against(case: RandomCase, steps: tuple[Step, ...]) -> float:
    lattice = make_lattice(case.steps, EXACT_OPTIONS)
    return largest_difference(case.shape(), replace(case, steps=steps).shape(lattice=lattice))


def _make_symmetry(
    title: str, measure: Callable[[RandomCase], float], bound: float, draw: Draw = draw_case
) -> Check:
    words = f"difference of the deflection, {RANDOM_CASES} random cases"

    @define_check(Group.SYMMETRIES, title, Quantity(words, at_most(bound), "mm"))
    def largest(rng: np.random.Generator) -> CheckOutcome:
        return CheckOutcome((worst([measure(draw(rng, 50.0, 1e-3)) for _ in range(RANDOM_CASES)]),))

    return largest


CHECKS = (
    balance,
    _make_symmetry("Mirror: bevel, base and its tilt to the other side", mirrored, 1e-9),
    _make_symmetry("EI and every mu doubled", doubled, 1e-7),
    _make_symmetry("A layer cut into two equal ones", cut_in_two, 1e-4),
    _make_symmetry("Sub-steps on the way", in_pieces, 1e-7),
    _make_symmetry("0.3 mm further and back; 3.7 mm back and again", there_and_back, 1e-7),
    _make_symmetry(
        "A Session gives the bits of follow, schedules of all inputs", one_by_one, 0.0, draw_schedule
    ),
    poses,
)
