import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import (
    TRUTH,
    assert_one_density,
    dataset,
    from_first_point,
    insertion,
    measure,
    medium,
    problem,
)
from problem_cases import make_problem
from pytest import approx
from refusals import refusal

from needlefit.datasets.insertion import Noise
from needlefit.errors import DataError
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.observations import OBSERVATIONS, make_observation
from needlefit.inference.likelihood.stated_errors import Discrepancy
from needlefit.mechanics.shape import compute_positions
from needlefit.schemas.recipe import LikelihoodRecord

STRAIGHT = np.column_stack([np.linspace(0, 40, 41), np.zeros(41)])


def straight(angle_sd=0.0, depth=40.0):
    return insertion(depth, angle_sd=angle_sd).with_points(STRAIGHT)


def test_independent_noise_has_the_deviations_of_all_errors():
    noise, measured = Noise(0.19, 0.05, 0.1, 5.0), straight(angle_sd=0.01)
    known = make_observation(dataset([], noise), measured, likelihood=LikelihoodRecord(noise="independent"))
    shift = 0.19 / math.sqrt(8 / math.pi)
    sd = np.sqrt(0.05**2 + 0.1**2 + shift**2 + (0.01 * STRAIGHT[:, 0]) ** 2)
    assert known.whitening == approx(np.diag(1 / sd))
    refusal(DataError, "point_sd_mm", lambda: make_observation(dataset([], Noise()), straight()))


def test_of_a_thinned_needle_every_so_many_points_up_to_the_tip_stay():
    found = OBSERVATIONS["points"].thin(insertion(39.0).with_points(STRAIGHT[:40]), 10)
    assert found.points[:, 0].tolist() == [*range(3, 40, 4)]


def test_a_model_error_fades_along_the_needle():
    noise, measured = Noise(point_sd=0.05), straight()
    plain, found = (
        make_observation(dataset([], noise), measured, model_error=one)
        for one in (None, Discrepancy(0.3, 8.0))
    )
    apart = np.subtract.outer(plain.nodes.s[0], plain.nodes.s[0])
    added = found.point_covariance - plain.point_covariance
    assert added == approx(0.09 * np.exp(-(apart**2) / 128))


@pytest.mark.parametrize(("compared", "count"), [("plane", 1), ("space", 2)])
def test_a_shift_across_costs_nothing_where_the_direction_alone_is_known(compared, count):
    """It is the limit of a prior of it that is flat: densities differ as with a wide one."""
    record, how = medium(1), LikelihoodRecord(bevel_spread=0.0)
    made = from_first_point(measure(TRUTH, record, insertion(50.0), 31))
    shifted = made.with_points(made.points + np.array([0.0, 0.3, (count - 1) * 0.2]))
    p, q = (
        make_problem(replace(dataset([one]), compared=compared), [one], record, how)
        for one in (made, shifted)
    )
    theta = p.parameters.theta(TRUTH)
    assert q.log_posterior(theta) == approx(p.log_posterior(theta), abs=1e-3)
    assert q.objective(theta) == approx(p.objective(theta), abs=1e-4)
    off = p.parameters.theta({**TRUTH, "bevel_mm": 0.12})
    (known,), squares = q.density.observations, []
    wide = np.linalg.inv(known.covariance() + 1e3**2 * known.free @ known.free.T)
    for at in (theta, off):
        shape = predict(q.values(at), record, shifted)
        left = known.stack(compute_positions(shape, known.nodes.s[0])) - known.stack(known.measured)
        squares.append(left @ wide @ left)
    rise = q.log_posterior(theta) - q.log_posterior(off)
    assert rise == approx((squares[1] - squares[0]) / 2, rel=1e-3) and rise > 1.0
    assert (known.rows, known.free.shape[1]) == (31 * count - count, count)
    assert_one_density(q, off)


# ---- exact derivatives of a problem, against central differences

PRIOR = {"bounds": [1e3, 1e9], "prior": {"median": 2e5, "factor": 2.0, "correlation": -0.6}}
ALPHA = {"bounds": [-30.0, 50.0], "prior": {"mean": 3.0, "sd": 2.0}}
LAYERS = {"boundaries": (9.0, 17.0, 26.0), "sequence": (1, 2, 1, 2)}

CASES = {
    "two layers, met twice": medium(),
    "tied": medium(mu2_pa={"tie": "40 * mu1_pa"}),
    "fixed bevel": medium(bevel_mm={"fixed": 0.08}),
    "stated before": medium(mu1_pa=PRIOR, alpha1=ALPHA),
    "guide": medium(guide_distance_mm={"bounds": [2.0, 60.0]}),
}


def case(name, **options):
    record = CASES[name]
    truth = {**TRUTH, "guide_distance_mm": 15.0} if name == "guide" else TRUTH
    made = [measure(truth, record, insertion(d, **LAYERS, side=side)) for d, side in ((34.3, 1), (41.0, -1))]
    p = problem(record, made, **options)
    return p, p.parameters.theta(truth) + 0.1 * np.cos(np.arange(len(p.names)))


@pytest.mark.parametrize("pose", ["known", "free"])
@pytest.mark.parametrize("name", CASES)
def test_values_and_derivatives_are_of_one_density(name, pose):
    assert_one_density(*case(name, pose=pose, drop=3.0 if pose == "free" else 0.0))
