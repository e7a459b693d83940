"""Check beams under a known uniform load, against their closed form.

The load is a very soft tissue whose cut lies so far away that it pulls with the same force everywhere.

The needle of length L stands clamped at its base and is loaded by q on its inserted part, s > a = L - D
from the base. Cantilever:

    24 EI u / q = s^2 ( 6 (L^2 - a^2) - 4 s (L - a) )               s < a
                  s^2 ( 6 L^2 - 4 s L + s^2 ) - a^3 ( 4 s - a )     s > a

A prop at s = p adds a force P that keeps u(p) = 0; it moves the beam by P p^2 (3 s - p) / 6 EI beyond, by
P s^2 (3 p - s) / 6 EI before the prop.
"""

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics.control import Controls, Guide, TrackedTip
from needlefit.mechanics.simulate import equilibrium
from needlefit.verification.cases import (
    PAPER_NEEDLE,
    interpolate,
    make_tissue,
    require_converged,
    sample_densely,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst

DEPTH = 90.0
LOAD = 1e-3  # N / mm
_FAR = 1e9  # mm, of the constraint points; the reaction varies by 1e-9 of itself while the needle bends


def cantilever_deflection(s: Floats, a: float) -> Floats:
    """Return the deflection (mm) at distances `s` from the base under the load beyond `a`."""
    L, EI = PAPER_NEEDLE.length, PAPER_NEEDLE.flexural_rigidity
    before = s**2 * (6 * (L**2 - a**2) - 4 * s * (L - a))
    beyond = s**2 * (6 * L**2 - 4 * s * L + s**2) - a**3 * (4 * s - a)
    return LOAD / (24 * EI) * np.where(s < a, before, beyond)


def prop_deflection(s: Floats, p: float) -> Floats:
    """Return the deflection (mm) at distances `s` from the base under a unit force at `p`."""
    near, far = np.minimum(s, p), np.maximum(s, p)
    moved: Floats = near**2 * (3 * far - near) / (6 * PAPER_NEEDLE.flexural_rigidity)
    return moved


def measure_error(propped_at: float | None, controls: Controls) -> float:
    """Return the largest error of the deflection along the needle, relative to the largest deflection."""
    # linear law: force = 3 mu e, and e is _FAR almost everywhere, so the load is LOAD
    tissue = make_tissue(mu=[LOAD / _FAR / 3], alpha=[1.0], thickness=[1e3 * _FAR], law="linear")
    depths = np.arange(DEPTH + 0.5)
    points = np.column_stack((depths, np.full(len(depths), _FAR)))
    shape = require_converged(equilibrium(PAPER_NEEDLE, tissue, points, controls))
    x = sample_densely(shape)
    s, a = x - x[0], PAPER_NEEDLE.length - DEPTH
    exact = cantilever_deflection(s, a)
    if propped_at is not None:
        at = np.array([propped_at])
        exact = exact - prop_deflection(s, propped_at) * (
            cantilever_deflection(at, a) / prop_deflection(at, propped_at)
        )
    return worst(np.abs(interpolate(shape, x) - exact)) / worst(np.abs(exact))


_GUIDE = -25.0  # mm: the place of the prop before the tissue
_WORDS = "largest error over largest deflection"


_LOADED = (
    "the load is the pull of a very soft foundation whose constraint points lie a thousand kilometres away"
)


def _check(title: str, propped_at: float | None, controls: Controls) -> Check:
    remark = _LOADED if propped_at is None else ""
    return Check(
        Group.CLOSED_FORMS, title, (Quantity(_WORDS, at_most(1e-7), ""),),
        lambda rng: CheckOutcome((measure_error(propped_at, controls),), remark),
    )  # fmt: skip


CHECKS = (
    _check("Cantilever under a uniform load on its outer 90 mm", None, Controls()),
    _check(
        "Propped cantilever, same load, free guide 25 mm before the tissue",
        PAPER_NEEDLE.length - DEPTH + _GUIDE,
        Controls(guides=(Guide(_GUIDE, slope=None),)),
    ),
    _check(
        "Propped cantilever, same load, the tip tracked at 0",
        PAPER_NEEDLE.length,
        Controls(tip=TrackedTip(0.0)),
    ),
)
