"""NIST's nonlinear regression problems, through the shells that needles are fitted with, unlogged."""

import numpy as np
import pytest
from inference_cases import squares_recipe
from nist_cases import DIGITS, LEVELS, attained, ended, regressions

from needlefit.inference.fit import StartPoint
from needlefit.inference.optimize import search

EVERY = list(regressions().values())
SECOND = {"enso": 478.25015804}  #: half the squares at minima that are not the certified ones


@pytest.mark.parametrize("one", EVERY, ids=lambda one: one.name)
def test_the_data_and_certified_values_belong_together(one):
    found = float(np.sum(one.residuals(np.array(one.certified)) ** 2))
    # eleven digits of the parameters give a sum of 1e-25 only to the square of what they round
    assert found == pytest.approx(one.squares, rel=1e-10, abs=1e-20)


def test_minima_that_are_not_the_certified_ones():
    counts = [sum(one.level == level for one in EVERY) for level in LEVELS]
    assert counts == [8, 11, 8]
    one = regressions()["enso"]
    ends = [ended(one, k, "neldermead", half=10.0, evaluations=4_000) for k in (0, 1)]
    assert [attained(one, end) for end in ends] == [False, True]
    settled = search(one.goal(), squares_recipe(evaluations=100), StartPoint(0, ends[0].theta))
    assert settled.succeeded and settled.objective == pytest.approx(SECOND["enso"], rel=1e-9)
    one = regressions()["nelson"]
    end = ended(one, 0, "neldermead", half=10.0)
    assert end.stopped == "flat" and not attained(one, end)


@pytest.mark.parametrize("start", [0, 1])
def test_least_squares_finds_every_certified_value_from_either_start(start):
    found = {one.name: (one, ended(one, start, "leastsquares")) for one in EVERY}
    digits = {name: one.digits(end.theta) for name, (one, end) in found.items()}
    assert min(digits.values()) >= DIGITS, digits
    assert all(end.succeeded for _, end in found.values())
