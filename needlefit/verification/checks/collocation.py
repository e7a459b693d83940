"""Single equilibria out of finished insertions, solved again by collocation."""

from dataclasses import dataclass

import numpy as np

from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.simulate import equilibrium, simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import NEEDLE, layers, solved
from needlefit.verification.check import Check, Group, Outcome, Quantity, at_most, worst
from needlefit.verification.collocation import collocate
from needlefit.verification.samples import read

FINE = ModelOptions(element=0.25, tolerance=1e-9)

_QUANTITIES = (
    Quantity("difference of the deflection, h = 0.25 mm", at_most(1e-6), "mm"),
    Quantity("difference of the deflection, h = 1 mm", at_most(1e-5), "mm"),
)


@dataclass(frozen=True)
class Insertion:
    """What is inserted how."""

    tissue: Tissue
    steps: tuple[Step, ...]


def difference(insertion: Insertion) -> tuple[float, float]:
    """Return how far the collocation of its last equilibrium is from ours on the fine and default mesh."""
    tissue, steps = insertion.tissue, insertion.steps
    constraints = solved(simulate_steps(NEEDLE, tissue, steps)).constraints
    controls = steps[-1].controls
    x, u = collocate(NEEDLE, tissue, constraints, controls)
    shapes = (equilibrium(NEEDLE, tissue, constraints, controls, rules) for rules in (FINE, ModelOptions()))
    fine, default = (worst(np.abs(read(solved(shape), x) - u)) for shape in shapes)
    return fine, default


def _check(title: str, tissue: Tissue, *steps: Step) -> Check:
    insertion = Insertion(tissue, steps)
    return Check(Group.COLLOCATION, title, _QUANTITIES, lambda rng: Outcome(difference(insertion)))


_FREE = Bevel(0.085)
CHECKS = (
    _check(
        "Four layers of the paper’s values, 35.3 mm deep",
        layers(mu=[0.2, 33.0, 0.2, 33.0], alpha=[1.0, -1.0, 1.0, -1.0], boundaries=[12.2, 18.7, 29.4]),
        Step(35.3, _FREE),
    ),
    _check(
        "Thin tissue (t = 5 mm), α = −10, base moved aside",
        layers(mu=[0.2, 2.0], alpha=[-10.0, -10.0], boundaries=[9.6], thickness=[5.0, 5.0]),
        Step(25.0, Bevel(0.25), Controls(base_y=2.0)),
    ),
    _check(
        "Thin tissue (t = 5 mm), α = 10, bevel turned over, free guide",
        layers(mu=[0.3, 1.0], alpha=[10.0, 10.0], boundaries=[11.5], thickness=[5.0, 5.0]),
        Step(14.5, Bevel(0.3)),
        Step(30.0, Bevel(0.3, -1), Controls(base_y=1.0, guides=(Guide(-15.0, 0.5, None),))),
    ),
    _check(
        "Neo-Hookean law, t = 5 mm, base moved aside",
        layers(mu=[0.4, 4.0], alpha=[-7.0, 9.0], boundaries=[10.4], thickness=[5.0, 5.0], law="neo_hookean"),
        Step(26.7, Bevel(0.2), Controls(base_y=2.0)),
    ),
    _check(
        "Friction, base tilted after 15 mm",
        layers(
            mu=[0.5, 5.0], alpha=[3.0, -4.0], boundaries=[13.3], thickness=[10.0, 10.0], friction=[2.0, 2.0]
        ),
        Step(15.0, Bevel(0.2)),
        Step(28.4, Bevel(0.2), Controls(base_slope=0.1)),
    ),
)
