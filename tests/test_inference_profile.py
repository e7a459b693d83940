"""Profiles of sums of squares whose profiles are known in closed form."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from pytest import approx

from needlefit.inference.identifiability.profile import (
    DEVIANCE_95,
    minimize_squares,
    summarize_profile,
    trace_profiles,
)

REACH = 20.0
VAST = np.full(2, 1e4)  # bounds so far away that they say nothing


@dataclass
class Known:
    """Residuals and their Jacobian as functions of two parameters; counts its evaluations."""

    residuals: Callable[[float, float], list[float]]
    slopes: Callable[[float, float], list[list[float]]]
    lower: np.ndarray = field(default_factory=lambda: np.full(2, -REACH))
    upper: np.ndarray = field(default_factory=lambda: np.full(2, REACH))
    names: tuple[str, ...] = ("x", "y")
    calls: int = 0

    def jacobian(self, theta):
        self.calls += 1
        return np.array(self.residuals(*theta), dtype=float), np.array(self.slopes(*theta), dtype=float)

    plain = None


def line(**changed):
    """Gaussian and linear: information [[5, 2], [2, 4]]."""
    return Known(lambda x, y: [x + 2 * y - 1, 2 * x - 3], lambda x, y: [[1, 2], [2, 0]], **changed)


def banana():
    """y follows x^2 within 0.1, x is 1 within 0.5."""
    return Known(lambda x, y: [(x - 1) / 0.5, (y - x**2) / 0.1], lambda x, y: [[2, 0], [-20 * x, 10]])


def found(target, k, start=(0.5, 0.5)):
    return summarize_profile(
        target, k, trace_profiles(target, [k], minimize_squares(target, np.array(start)))[k]
    )


def test_a_linear_gaussian_has_the_parabola_of_its_information():
    for k, sd in ((0, math.sqrt(4 / 16)), (1, math.sqrt(5 / 16))):
        p = found(line(lower=-VAST, upper=VAST), k)
        assert p.sd == approx(sd)
        best = (1.5, -0.25)[k]
        assert p.best == approx(best)
        assert p.deviance == approx(((p.at - best) / sd) ** 2, abs=1e-6)
        assert p.slope == approx(2 * (p.at - best) / sd**2, abs=1e-5)
        half = math.sqrt(DEVIANCE_95) * sd
        assert (p.low, p.high) == approx((best - half, best + half))
        assert p.closed
        assert p.deviance[0] > DEVIANCE_95 < p.deviance[-1]
    target = line()
    paths = trace_profiles(target, [0], minimize_squares(target, np.zeros(2)), scale=4.0)
    wide = summarize_profile(target, 0, paths[0], scale=4.0)
    assert wide.high - wide.best == approx(2 * (found(line(), 0).high - 1.5))
    assert wide.sd == approx(1.0, rel=0.01)


def test_a_banana_has_the_known_curves():
    """x: all of its deviance is its own. y: x is squeezed between 1 and the root of y."""
    along = found(banana(), 0)
    assert along.deviance == approx(((along.at - 1) / 0.5) ** 2, abs=5e-3)
    up = found(banana(), 1)
    x = np.linspace(-3, 4, 200_001)
    for y, deviance in zip(up.at, up.deviance, strict=True):
        assert deviance == approx(np.min(((x - 1) / 0.5) ** 2 + ((y - x**2) / 0.1) ** 2), abs=5e-3)
    # the parabola would end it at 1 - 1.96 * 1.005, where there is no banana
    assert up.low > -0.3 > up.best - math.sqrt(DEVIANCE_95) * up.sd
    assert up.high > up.best + math.sqrt(DEVIANCE_95) * up.sd


def test_a_parameter_without_effect_or_that_another_one_compensates_is_flat():
    target = Known(lambda x, y: [y - 1.0], lambda x, y: [[0.0, 1.0]])
    p = found(target, 0)
    assert p.ends == ("bound", "bound") and p.rise == approx(0.0, abs=1e-9) and p.sd == math.inf
    assert (p.low, p.high) == (-REACH, REACH)
    assert target.calls < 60
    narrow = Known(
        lambda x, y: [x + y], lambda x, y: [[1.0, 1.0]], lower=np.array([-20, -1]), upper=np.array([20, 1])
    )
    q = found(narrow, 0)
    assert q.closed and (q.low, q.high) == approx((-1 - 1.96, 1 + 1.96), abs=0.01)


def test_an_interval_that_a_bound_cuts_is_open_there():
    p = found(line(lower=np.array([1.2, -20.0])), 0, (2.0, 0.0))
    assert p.ends == ("bound", "closed") and p.low == 1.2
    assert not p.closed
    q = found(line(upper=np.array([1.0, 20.0])), 0, (0.0, 0.0))  # the best point itself lies at the bound
    assert q.ends == ("closed", "bound") and q.best == q.high == 1.0


def test_failures_on_the_way_out_are_flagged():
    def residuals(x, y):
        return [0.1 * x if x < 3 else math.nan, y]

    p = found(Known(residuals, lambda x, y: [[0.1, 0], [0, 1.0]]), 0)
    assert p.ends[1] == "lost" and 2.5 < p.high < 3.0
    assert p.ends[0] == "closed" and p.low == approx(-19.6, abs=0.01)
