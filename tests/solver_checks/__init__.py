"""Solutions of the model by other means than its solver, and how far the solver is from them.

`beams` are closed forms, `clamped` manufactured solutions. Errors are the largest at and between nodes.
`tests/test_mechanics_verification.py` states the bounds, `benchmarks/verification.py` prints what is found.
"""

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.needle import Needle

NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)


def react(tissue, layer, e, slope):
    """Return the reaction k(lambda) e g, N/mm, at deflections `e` (mm); real or complex."""
    # not abs(e): of a complex number it is real, and the complex step would be lost
    stretch = 1 - np.where(e.real < 0, -e, e) / tissue.thickness[layer]
    k = tissue.mu[layer] * LAWS[tissue.law].k(stretch, *tissue.shape[:, layer])
    return k * e * (1 - tissue.friction[layer] * slope**2 / (1 + slope**2))


def sample_between(edges):
    """Return eight positions inside each interval between increasing edges."""
    return (edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(8) + 0.5) / 8).ravel()


def interpolate(shape, x):
    """Return the deflection, mm, at depths x, by the cubics that the nodes define."""
    assert shape.converged
    return CubicHermiteSpline(shape.x, shape.u, shape.slope)(x)
