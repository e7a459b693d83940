"""Check symmetries of the model: handedness, units of force, division of layers, sub-steps, overshooting."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from needlefit.mechanics.control import Bevel, Controls, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import make_lattice
from needlefit.mechanics.session import Session
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import (
    EXACT_OPTIONS,
    Draw,
    RandomCase,
    draw_case,
    draw_schedule,
    largest_difference,
    require_converged,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst

RANDOM_CASES = 10


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


def _check(title: str, measure: Callable[[RandomCase], float], bound: float, draw: Draw = draw_case) -> Check:
    words = f"difference of the deflection, {RANDOM_CASES} random cases"

    def largest(rng: np.random.Generator) -> CheckOutcome:
        return CheckOutcome((worst([measure(draw(rng, 50.0, 1e-3)) for _ in range(RANDOM_CASES)]),))

    return Check(Group.SYMMETRIES, title, (Quantity(words, at_most(bound), "mm"),), largest)


CHECKS = (
    _check("Mirror: bevel, base and its tilt to the other side", mirrored, 1e-9),
    _check("EI and every mu doubled", doubled, 1e-7),
    _check("A layer cut into two equal ones", cut_in_two, 1e-4),
    _check("Sub-steps on the way", in_pieces, 1e-7),
    _check("0.3 mm further and back; 3.7 mm back and again", there_and_back, 1e-7),
    _check("A Session gives the bits of follow, schedules of all inputs", one_by_one, 0.0, draw_schedule),
)
