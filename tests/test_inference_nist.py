"""NIST's nonlinear regression problems, through the shells that needles are fitted with, unlogged."""

import numpy as np
import pytest
from inference_cases import recipe
from nist_cases import Regression, regressions

from needlefit.inference.optimize import search
from needlefit.inference.starts import Place, Start

EVERY = list(regressions().values())
EASIER = [one for one in EVERY if one.level != "higher"]
DIGITS, NEAR = 6, 1e-6


def ended(one: Regression, start: int, algorithm: str, half: float = np.inf) -> Start:
    return search(
        one.goal(half),
        recipe(algorithm=algorithm, evaluations=50_000, tolerance=1e-13),
        Place(0, one.starts[start]),
    )


def attained(one: Regression, start: Start) -> bool:
    return start.objective <= 0.5 * one.squares * (1 + NEAR) or one.digits(start.theta) >= DIGITS


@pytest.mark.parametrize("one", EVERY, ids=lambda one: one.name)
def test_the_data_and_certified_values_belong_together(one):
    found = float(np.sum(one.residuals(np.array(one.certified)) ** 2))
    # eleven digits of the parameters give a sum of 1e-25 only to the square of what they round
    assert found == pytest.approx(one.squares, rel=1e-9, abs=1e-20)


@pytest.mark.parametrize("start", [0, 1])
def test_least_squares_finds_every_certified_value_from_either_start(start):
    found = {one.name: (one, ended(one, start, "leastsquares")) for one in EVERY}
    digits = {name: one.digits(end.theta) for name, (one, end) in found.items()}
    assert min(digits.values()) >= DIGITS, digits
    assert all(end.succeeded for _, end in found.values())


@pytest.mark.parametrize(
    ("algorithm", "hits"),
    [("slsqp", 25), ("lbfgs", 17), ("praxis", 19), ("neldermead", 20), ("bobyqa+neldermead", 24)],
)
def test_other_algorithms_never_call_a_miss_a_success(algorithm, hits):
    ends = [(one, ended(one, k, algorithm, half=10.0)) for one in EASIER for k in (0, 1)]
    hit = [attained(one, end) for one, end in ends]
    false = [
        (one.name, end) for (one, end), good in zip(ends, hit, strict=True) if end.succeeded and not good
    ]
    assert not false
    assert sum(hit) >= hits  # of 26; the six lost at worst are sums of exponentials that coincide
