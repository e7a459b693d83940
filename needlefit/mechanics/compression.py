"""Stress of a one-term, incompressible Ogden solid in an unconfined uniaxial compression test.

What a testing machine sees of the law whose tangent modulus is the foundation's k. With the energy

    W = 2 mu / alpha^2 (lambda_1^alpha + lambda_2^alpha + lambda_3^alpha - 3)

in which lambda_1 = lambda and the other two are lambda^(-1/2),

mu is the shear modulus, the nominal stress (force over the area before) is P = dW / d lambda, and the true
one (force over the area now, which incompressibility makes 1 / lambda times as large) is

    sigma = lambda P = 2 mu / alpha (lambda^alpha - lambda^(-alpha / 2)),        k = d sigma / d lambda

so the paper's Eq. 4 differentiates the *true* stress. Stresses are negative in compression, as in the paper,
whose k is positive. Written with h = ln lambda,

    sigma = 3 mu h exp(alpha h / 4) sinh(x) / x,        x = 3/4 alpha h

nothing is divided by alpha: at alpha = 0 this is 3 mu h, Hencky's solid.
"""

from typing import Literal, get_args

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError

#: force over the area before compression (engineering stress), or over the area now (Cauchy's)
StressMeasure = Literal["nominal", "true"]

MAX_STRETCH = 10.0  #: largest stretch, length over initial length: a larger number is likely a percentage
SERIES_LIMIT = 1e-2  #: value of |x| below which two terms of a series are more exact than the closed form


def compute_stress(mu: float, alpha: float | Floats, stretch: Floats, measure: StressMeasure) -> Floats:
    """Return the stress (N,) at `stretch` (N,), in the unit of the shear modulus `mu`.

    ModelError for another measure, and for stretches (height over initial height) at or below 0, or in %.
    """
    if measure not in get_args(StressMeasure):
        raise ModelError(f"measure is {measure!r:.20}", expected="nominal or true")
    if not 0 < np.min(stretch) <= np.max(stretch) <= MAX_STRETCH:
        problem = f"stretches are {np.min(stretch):g} to {np.max(stretch):g}"
        raise ModelError(problem, expected=f"above 0, at most {MAX_STRETCH:g}; 80 % are 0.8")
    h = np.log(stretch)
    true_stress = 3 * mu * h * np.exp(alpha * h / 4) * _sinhc(0.75 * alpha * h)
    return true_stress / stretch if measure == "nominal" else true_stress


def _sinhc(x: Floats) -> Floats:
    small = np.abs(x) < SERIES_LIMIT
    safe = np.where(small, 1.0, x)
    return np.where(small, 1 + x**2 / 6 * (1 + x**2 / 20), np.sinh(safe) / safe)
