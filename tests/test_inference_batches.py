"""What a set of values gives does not depend on the sets beside it, nor on threads: to the bit."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import NOISE, TRUTH, insertion, measure, medium, problem
from track_cases import GUIDE, measured, track
from track_cases import TRUTH as TRACK_TRUTH
from track_cases import problem as track_problem

from needlefit.inference.problem import Problem
from needlefit.schemas.recipe import LikelihoodRecord

COUNTS = [1, 2, 3, 8, 9]


def layered(depths: str, pose: str = "known", noise_scale: float | str = "estimated") -> Problem:
    record = medium(alpha1={"bounds": [-5.0, 5.0]})
    planned = [insertion(d, (9.2, 17.0), (1, 2, 1), side) for d, side in ((22.3, 1), (26.0, -1))]
    made = [
        replace(measure(TRUTH, record, one), specimen="one", boundary_sd=0.15, depth_sd=0.1)
        for one in planned
    ]
    how = LikelihoodRecord(depths=depths, noise_scale=noise_scale, bevel_spread=0.1)
    return problem(record, made, how=how, noise=NOISE, pose=pose)


def tracked() -> Problem:
    return track_problem([measured(track(f"run{n}", n * GUIDE), 3.0, 0.02, n) for n in (0, 1)])


CASES = {
    "linear": lambda: layered("linear"),
    "fixed, free pose": lambda: layered("fixed", "free", 1.0),
    "quadrature": lambda: layered("quadrature"),
    "tracks": tracked,
}


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[Problem, np.ndarray]:
    one = CASES[request.param]()
    truth = TRACK_TRUTH if request.param == "tracks" else TRUTH | {"bevel_spread": 0.07}
    at = one.parameters.theta(truth)
    rng = np.random.default_rng(2)
    thetas = at + 0.05 * rng.normal(size=(max(COUNTS), len(at)))
    return one, np.clip(thetas, one.lower, one.upper)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("count", COUNTS)
def test_neighbours_and_threads_change_no_bit(case, count: int, threads: int) -> None:
    one, thetas = case
    sets = [one.values(theta) for theta in thetas[:count]]
    density = replace(one).density
    for found, theta in zip(density.jacobians(sets, threads), thetas, strict=False):
        for part, expected in zip(found, one.jacobian(theta), strict=True):
            np.testing.assert_array_equal(part, expected)
    values = density.log_densities(sets, threads)
    for (value, slope), other, theta in zip(density.gradients(sets, threads), values, thetas, strict=False):
        assert value == other == one.log_posterior(theta)
        np.testing.assert_array_equal(slope, one.gradient(theta)[1])


def test_values_and_derivatives_are_of_one_state(case) -> None:
    one, thetas = case
    for theta in thetas[:2]:
        assert one.gradient(theta)[0] == one.log_posterior(theta) == one.log_posteriors(theta[None])[0]
        np.testing.assert_allclose(one.jacobian(theta)[0], one.residuals(theta), rtol=0, atol=1e-12)
        assert one.objective_gradient(theta)[0] == one.objective(theta)


def test_a_set_that_fails_affects_no_other(case) -> None:
    one, thetas = case
    sets = [one.values(theta) for theta in thetas[:4]]
    good = one.density.jacobians([sets[0], *sets[2:]])
    sets[1] = sets[1] | {one.medium.bevel_parameter: np.nan}
    mixed = one.density.jacobians(sets)
    rows = sum(known.rows for known in one.density.observations)
    assert np.isnan(mixed[1][0][:rows]).any()
    for found, expected in zip([mixed[0], *mixed[2:]], good, strict=True):
        for part, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(part, other)
    assert np.isnan(one.density.log_densities(sets)).tolist() == [False, True, False, False]
