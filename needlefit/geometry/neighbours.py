"""Predict each point of a curve from its neighbours: what a single point adds is left over."""

import numpy as np

from needlefit.arrays import Floats

#: neighbours on either side, at least and at most; between, those within the reach, mm
MIN_NEIGHBOURS, MAX_NEIGHBOURS, REACH_MM = 4, 20, 8.0
MAX_ORDER = 3  #: of the polynomial through neighbours


def leave_one_out(x: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return how far each point (N, k) is from a cubic through its neighbours, and a factor (N,).

    The factor is that by which the standard deviation of this distance is larger than that of a point, of
    independent errors. At the ends all neighbours lie on one side. `x` (N,) increases; N is at least 4.
    """
    count, step = len(x), float(np.median(np.diff(x)))
    side = int(np.clip(REACH_MM / max(step, 1e-9), MIN_NEIGHBOURS, MAX_NEIGHBOURS))
    near = min(2 * side, count - 1)
    order = min(MAX_ORDER, near - 2)
    first = np.clip(np.arange(count) - near // 2, 0, count - near - 1)
    window = first[:, None] + np.arange(near + 1)  # (N, near + 1), with the point itself
    others = window[window != np.arange(count)[:, None]].reshape(count, near)
    away = x[others] - x[:, None]
    scale = np.abs(away).max(axis=1, keepdims=True)
    powers = (away / scale)[..., None] ** np.arange(order + 1)
    weights = np.linalg.pinv(powers)[:, 0, :]  # (N, near): of the polynomial's value at the point
    left = values - np.einsum("ij,ijk->ik", weights, values[others])
    return left, np.sqrt(1.0 + np.sum(weights**2, axis=1))
