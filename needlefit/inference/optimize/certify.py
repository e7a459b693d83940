"""Whether a search ended where it says: at a minimum, and one that every parameter has a say in.

A search ends by its tolerance on a plateau and in a narrow valley as well as at a minimum. Where the goal is
a sum of squares the exact Jacobian J tells them apart: the best step s within the bounds of the linear
problem, min |r + J s|, would gain next to nothing at a minimum.
"""

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from needlefit.inference.ledger import Ended, Ledger

Floats = NDArray[np.float64]

ATTAINED = 1e-6
"""Largest gain of the value that a further step may promise; in units of the mean square where nothing says
what is negligible, so that the unit of the sum of squares means nothing."""

ROUNDING = 1e-8
"""A further step that changes no parameter by more than this part of it promises nothing."""

FLAT = 1e-8
"""A parameter whose whole scale moves the residuals by less than this part of them has no say; neither has a
combination of parameters whose effects cancel to this part of each."""


def certified(books: Ledger, reason: str) -> str:
    """Return why a search ended, once its best point was looked at: "tolerance" only at a minimum.

    "stalled" is no minimum, "flat" one in which some parameter or combination has no say, "bound" one only
    because the box ends there. A goal that is no sum of squares keeps the reason that the algorithm gave.
    """
    settled = reason in ("tolerance", "roundoff") or reason.startswith("nlopt failed")
    if not settled or books.theta is None or books.goal.jacobian is None or not len(books.theta):
        return reason
    found, books.reason = None, ""
    books.budget = books.evaluations + 1  # the look is no part of the search
    with suppress(Ended):
        found = books.jacobian(books.theta)
    return books.reason or reason if found is None else _judged(books, *found)


def _judged(books: Ledger, residuals: Floats, jacobian: Floats) -> str:
    assert books.theta is not None
    goal, theta = books.goal, books.theta
    spans = goal.upper - goal.lower
    scales = np.where(np.isfinite(spans), spans, np.maximum(np.abs(theta), 1e-300))
    columns = jacobian * scales  # (R, P) per whole scale of each parameter
    lengths = np.linalg.norm(columns, axis=0)
    free = _free(books, residuals @ jacobian)
    if not np.any(free):
        return "bound"
    if np.any(lengths[free] <= FLAT * np.linalg.norm(residuals)):
        return "flat"
    directions = columns[:, free] / lengths[free]
    if np.linalg.svd(directions, compute_uv=False)[-1] <= FLAT:
        return "flat"
    unit = scales[free] / lengths[free]
    low, high = (goal.lower - theta)[free] / unit, (goal.upper - theta)[free] / unit
    best = lsq_linear(directions, -residuals, (np.minimum(low, 0), np.maximum(high, 0)))
    gain = 0.5 * float(residuals @ residuals) - best.cost
    small = np.all(np.abs(best.x * unit) <= ROUNDING * np.abs(theta[free]))
    mean = float(residuals @ residuals) / max(1, len(residuals) - len(theta))
    if not small and gain > ATTAINED * (1.0 if goal.negligible else mean):
        return "stalled"
    return "tolerance" if np.all(free) else "bound"


def _free(books: Ledger, slope: Floats) -> NDArray[np.bool_]:
    """Return which parameters (P,) are not held by a bound that the value falls towards."""
    assert books.theta is not None
    goal, theta = books.goal, books.theta
    held_low = (theta - goal.lower <= ROUNDING * np.maximum(1, np.abs(theta))) & (slope > 0)
    held_high = (goal.upper - theta <= ROUNDING * np.maximum(1, np.abs(theta))) & (slope < 0)
    return ~(held_low | held_high)
