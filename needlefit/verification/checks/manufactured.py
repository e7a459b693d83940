"""Manufactured solutions: does the error fall as fast as theory says, in the tissue, between the nodes?

Cubic elements promise order 4 in the deflection and 3 in the slope. At the nodes themselves the slope
superconverges, with order 4.
"""

import numpy as np

from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import layers
from needlefit.verification.check import Check, Group, Outcome, Quantity, about
from needlefit.verification.manufactured import NODAL, NORMS, refine

_QUANTITIES = tuple(
    Quantity(f"order of the {norm}", about(order, 0.15), "")
    for norm, order in zip(NORMS, (4.0, 3.0), strict=True)
)
_PLACE = 17.37  # mm: an interface that no mesh has a node at
_THIN = ([0.5, 3.0], [8.0, -6.0], [_PLACE], [2.0, 1.0])  # alpha plays no part in the neo-Hookean law
_ROUGH = layers(*_THIN, friction=[50.0, 50.0])  # so strong that the small slopes show it

CASES: dict[str, tuple[Tissue, float]] = {
    "One layer, linear law": (layers([1.0], [1.0], law="linear"), 1.0),
    "Two layers, interface on an element boundary, linear law": (
        layers([0.5, 5.0], [1.0, 1.0], [16.0], law="linear"),
        1.0,
    ),
    "Two layers, interface inside elements, linear law": (
        layers([0.5, 5.0], [1.0, 1.0], [_PLACE], law="linear"),
        1.0,
    ),
    "Two layers, interface inside elements, neo-Hookean law in thin tissue": (
        layers(*_THIN, law="neo_hookean"),
        1.0,
    ),
    "Two layers, interface inside elements, Ogden law in thin tissue": (layers(*_THIN), 1.0),
    "The same with friction": (_ROUGH, 1.0),
    "The same with a first cell too short for a node at the entry": (_ROUGH, 0.4),
}
"""Tissue, and the first cell in elements."""


def _check(title: str, tissue: Tissue, first_cell: float) -> Check:
    def measure(rng: np.random.Generator) -> Outcome:
        curve = refine(title, tissue, first_cell)
        return Outcome(tuple(curve.order(norm) for norm in NORMS), curves=(curve,))

    return Check(Group.MANUFACTURED, title, _QUANTITIES, measure)


def _at_nodes(rng: np.random.Generator) -> Outcome:
    curves = [refine(title, *case) for title, case in CASES.items()]
    return Outcome(tuple(float(np.min([curve.order(norm) for curve in curves])) for norm in NODAL))


_NODES = Check(
    Group.MANUFACTURED,
    "All of these at the nodes alone, where the slope superconverges",
    tuple(Quantity(f"lowest order of the {norm}", about(4.0, 0.2), "") for norm in NODAL),
    _at_nodes,
)

CHECKS = (*(_check(title, *case) for title, case in CASES.items()), _NODES)
