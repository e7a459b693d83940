"""One stage of a search by nonlinear least squares, with the exact Jacobian, in theta itself.

SciPy's trust region method within the bounds. As with nlopt, the best point is the ledger's own.
"""

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from needlefit.inference.ledger import Ended, Ledger

Floats = NDArray[np.float64]

ROUNDING = 1e-15
"""Relative change of the sum of squares, and of theta, under which it ends, unless more is negligible."""

RESIDUALS = 1e2
"""About as large as half the squares are at their least: a part of them is negligible."""

SAME, LOST = 1e-6, 1e-12
"""Differences between value and sum of squares from which on one does not stand for the other: of the best
value, and of the first one, next to which the constant between them was found."""


def stage(books: Ledger, start: Floats) -> str:
    """Search from theta `start` (P,); return why it ended."""
    reason = ""
    with suppress(Ended):
        reason = _squares(books, start)
    return books.reason or reason


def _squares(books: Ledger, start: Floats) -> str:
    if not books.calibrate(start):
        return "failed at its start"
    first = abs(books.objective)
    small = max(ROUNDING, books.goal.negligible / RESIDUALS)
    if len(start) == 0:
        return "tolerance"

    known = _Known(books)
    found = least_squares(
        known.residuals,
        np.clip(start, books.goal.lower, books.goal.upper),
        jac=known.slopes,
        bounds=(books.goal.lower, books.goal.upper),
        x_scale="jac",
        ftol=small,
        xtol=small,
        gtol=None,  # absolute: it would depend on the units of theta
        max_nfev=books.budget,  # the ledger ends it, which counts the Jacobians too
    )
    return _checked(books, LOST * first, "tolerance" if found.status > 0 else "budget")


class _Known:
    """Residuals and Jacobian from one evaluation: most steps are taken, and then ask for both.

    Attributes
    ----------
    theta, slopes_there : (P,) and (R, P) arrays
        Where it was asked last, and the Jacobian there; None if there is none.
    """

    def __init__(self, books: Ledger) -> None:
        self._books = books
        self._theta: Floats | None = None
        self._slopes: Floats | None = None

    def residuals(self, theta: Floats) -> Floats:
        """Return (R,); a single infinite one where they failed."""
        found = self._books.jacobian(theta)
        self._theta, self._slopes = theta.copy(), None if found is None else found[1]
        return np.array([np.inf]) if found is None else found[0]

    def slopes(self, theta: Floats) -> Floats:
        """Return (R, P); where it cannot be computed the search ends, its best point kept."""
        if self._theta is None or not np.array_equal(theta, self._theta):
            self.residuals(theta)
        if self._slopes is None:
            self._books.reason = "no Jacobian"
            raise Ended
        return self._slopes


def _checked(books: Ledger, lost: float, reason: str) -> str:
    """Compare the best sum of squares with the value that it stands for."""
    assert books.theta is not None
    claimed, books.objective = books.objective, np.inf
    if abs(books.value(books.theta) - claimed) > SAME * (1 + abs(claimed)) + lost:
        return "no sum of squares"
    return reason
