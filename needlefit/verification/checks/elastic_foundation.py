"""Hetenyi's beam on an elastic foundation: the base, or the entry, is displaced by 1 mm."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from needlefit.mechanics.control import Controls, Guide
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import equilibrium
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.cases import NEEDLE, solved
from needlefit.verification.check import Check, Group, Outcome, Quantity, at_most, worst
from needlefit.verification.foundation import hetenyi
from needlefit.verification.samples import dense, read

Floats = NDArray[np.float64]

EI = NEEDLE.flexural_rigidity
FREE = 20.0  # mm between base and entry
SOFT, STIFF = 0.6, 99.0  # N / mm^2: 3 mu of the paper's layers
INTERFACE = 12.37  # mm: inside an element


def error(
    k: tuple[float, ...],
    boundaries: tuple[float, ...],
    depth: float,
    controls: Controls,
    exact: Callable[[Floats], Floats],
) -> float:
    """Return the largest error of the inserted needle's deflection, mm, at and between the nodes."""
    tissue = Tissue(mu=np.array(k) / 3, alpha=np.ones(len(k)), boundaries=np.array(boundaries), law="linear")
    depths = np.arange(depth + 0.5)
    points = np.column_stack((depths, np.zeros(len(depths))))
    shape = solved(equilibrium(Needle(depth + FREE, EI), tissue, points, controls))
    x = dense(shape, 0.0)
    return worst(np.abs(read(shape, x) - exact(x)))


def finite(k: tuple[float, ...], boundaries: tuple[float, ...] = (), depth: float = 40.0) -> float:
    """Return the error on layers that end under the tip."""
    exact = hetenyi(EI, np.array(k), np.array([0.0, *boundaries, depth]), FREE)
    return error(k, boundaries, depth, Controls(base_y=1.0), exact)


def endless(k: tuple[float, ...], boundaries: tuple[float, ...], depth: float) -> float:
    """Return the error on a last layer that never ends; the tip stands where the wave has died away."""
    exact = hetenyi(EI, np.array(k), np.array([0.0, *boundaries, np.inf]), FREE)
    return error(k, boundaries, depth, Controls(base_y=1.0), exact)


def clamped_at_the_entry(k: float, depth: float) -> float:
    """Return the error where a guide clamps the needle at the entry, 1 mm aside: Hetenyi's own formula."""
    beta = (k / (4 * EI)) ** 0.25
    held = Controls(guides=(Guide(0.0, 1.0, 0.0, in_tissue=True),))
    return error((k,), (), depth, held, lambda x: np.exp(-beta * x) * (np.cos(beta * x) + np.sin(beta * x)))


def _check(title: str, measure: Callable[[], float]) -> Check:
    words = "largest error over the displacement imposed"
    return Check(
        Group.CLOSED_FORMS, title, (Quantity(words, at_most(1e-5), ""),), lambda rng: Outcome((measure(),))
    )


CHECKS = (
    _check(f"Beam on a finite elastic foundation, k = {SOFT:g} MPa", lambda: finite((SOFT,))),
    _check(f"Beam on a finite elastic foundation, k = {STIFF:g} MPa", lambda: finite((STIFF,))),
    _check(
        f"Beam on two finite layers, {SOFT:g} and {STIFF:g} MPa, interface at {INTERFACE} mm",
        lambda: finite((SOFT, STIFF), (INTERFACE,)),
    ),
    _check(
        f"Beam on two finite layers, {STIFF:g} and {SOFT:g} MPa, interface at {INTERFACE} mm",
        lambda: finite((STIFF, SOFT), (INTERFACE,)),
    ),
    _check(
        "Beam on a semi-infinite foundation, k = 30 MPa, clamped where it begins",
        lambda: clamped_at_the_entry(30.0, 130.0),
    ),
    _check(
        f"Beam on a semi-infinite foundation, k = {STIFF:g} MPa, behind a free span",
        lambda: endless((STIFF,), (), 120.0),
    ),
    _check(
        f"Beam on two layers, {SOFT:g} and {STIFF:g} MPa, the second semi-infinite",
        lambda: endless((SOFT, STIFF), (INTERFACE,), 120.0),
    ),
)
