"""One insertion that was measured at several depths: one bevel in the likelihood and in predictions."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, dataset, insertion, measure, medium, problem
from scipy.stats import multivariate_normal

from needlefit.datasets.insertion import Noise
from needlefit.datasets.select import find_repeats
from needlefit.errors import ConfigError
from needlefit.inference.identifiability.precision import difference_jacobian
from needlefit.inference.likelihood.marginal import (
    linear_residuals,
    linearize_residuals,
    log_marginals,
    mixing_matrices,
    solve_shared,
)
from needlefit.inference.likelihood.nodes import group_nodes, make_nodes
from needlefit.inference.predict import Draws
from needlefit.schemas.recipe import LikelihoodRecord, RecipeRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.folds import Fold
from needlefit.studies.held_out_predictions import predict_held_out
from needlefit.studies.job import Job

LINE = np.linspace(0.0, 40.0, 41)
SCALE, SPREAD = 1.3, 0.3
ROWS = 6
NAMES = ("A", "B", "C", "D", "E")
FINE = Noise(0.0, 0.02, 0.0, 5.0)


def linear_case(depths="linear"):
    """Two depths of one hole and a hole of one: nodes, residuals at them, and their covariance."""
    rng = np.random.default_rng(3)
    layered = replace(insertion(40.0, (12.0, 20.0), (1, 2, 3)), boundary_sd=0.15, boundary_shared_sd=0.0)
    first, bevel, pose = rng.normal(size=(3, 3, ROWS))
    slopes = 0.4 * rng.normal(size=(3, 2, ROWS))
    made, whites, total = [], [], np.zeros((3, ROWS, 3, ROWS))
    for k, name in enumerate(("A", "A", "B")):
        one = make_nodes(replace(layered, specimen=name), LINE, depths, bevel=True, constants=1)
        made.append(one.share_bevel((name, 0)) if name == "A" else one)
        moves = [first[k] + sign * slope for slope in slopes[k] for sign in (-1, 1)]
        turned = first[k] + np.outer([-0.1, 0.1], bevel[k])
        whites.append(np.vstack([first[k], *moves, turned, pose[k]]))
        for i in range(2) if k < 2 else (2,):
            total[k, :, i] = SPREAD**2 * np.outer(bevel[k], bevel[i])
        total[k, :, k] += SCALE**2 * np.eye(ROWS) + slopes[k].T @ slopes[k] + np.outer(pose[k], pose[k])
    return tuple(made), whites, first, total.reshape(3 * ROWS, 3 * ROWS), bevel


def density(made, whites, spread=SPREAD):
    return sum(
        log_marginals([whites[k][None] for k in members], group, np.array([SCALE]), np.array([spread]))[0]
        for members, group in group_nodes(made)
    )


def test_the_depths_of_a_hole_share_one_bevel_in_the_gaussian_of_their_covariance():
    made, whites, first, covariance, _ = linear_case()
    assert [members for members, _ in group_nodes(made)] == [(0, 1), (2,)]
    exact = multivariate_normal(cov=covariance).logpdf(first.ravel())
    assert density(made, whites) - 9 * math.log(2 * math.pi) == pytest.approx(exact, abs=1e-9)


def test_the_bevel_of_a_hole_given_its_depths_is_the_gaussians():
    made, whites, first, covariance, bevel = linear_case()
    (_, group), _ = group_nodes(made)
    many = [white[None] for white in whites[:2]]
    mean, found = solve_shared(many, group, np.array([SCALE]), np.array([SPREAD]))
    loads = SPREAD * bevel[:2].ravel()
    gain = np.linalg.solve(covariance[: 2 * ROWS, : 2 * ROWS], loads)
    # residuals are simulated minus measured: a needle that bent more has a negative one
    assert mean[0, 0] == pytest.approx(-gain @ first[:2].ravel())
    assert found[0, 0, 0] == pytest.approx(1 - gain @ loads)


def test_derivatives_by_residuals_and_spread_are_those_of_differences():
    made, whites, *_ = linear_case()
    (_, group), _ = group_nodes(made)
    made, chosen = made[:2], whites[:2]
    rng = np.random.default_rng(9)
    steps = [rng.normal(size=white.shape) for white in chosen]
    by = [np.stack([np.zeros_like(step), step], axis=-1) for step in steps]

    def at(theta):
        return [white + theta[1] * step for white, step in zip(chosen, steps, strict=True)]

    def residuals(theta):
        many = [white[None] for white in at(theta)]
        found = linear_residuals(many, group, np.array([SCALE]), np.array([SPREAD * math.exp(theta[0])]))
        return np.append(*(part[0] for part in found))

    def log_density(theta):
        return np.atleast_1d(density(made, at(theta), SPREAD * math.exp(theta[0])))

    mixed, by_spread = mixing_matrices(chosen, group, SCALE, SPREAD)
    by_step = -sum(np.sum(m @ w * step) for m, w, step in zip(mixed, chosen, steps, strict=True))
    small = np.full(2, 1e-5)
    np.testing.assert_allclose(
        [by_spread, by_step], difference_jacobian(log_density, np.zeros(2), small)[0], rtol=1e-6
    )
    many, at_one = [white[None] for white in chosen], (np.array([SCALE]), np.array([SPREAD]))
    slopes = linearize_residuals(many, [one[None] for one in by], group, at_one, np.array([1.0, 0.0]))[2:]
    exact = np.vstack([part[0] for part in slopes])
    np.testing.assert_allclose(exact, difference_jacobian(residuals, np.zeros(2), small), atol=1e-7)
    found, log_det = (part[0] for part in linear_residuals(many, group, *at_one))
    assert -0.5 * (found @ found + log_det) == pytest.approx(
        density(made, chosen) + 2 * ROWS * math.log(SCALE)
    )


def test_quadrature_refuses_a_shared_bevel():
    with pytest.raises(ConfigError) as raised:
        linear_case("quadrature")
    assert raised.value.key == "likelihood.depths"


def holes(depths=(32.0, 36.0), factors=(1.0,) * 5):
    """One shape for each hole and depth, each hole with a bevel of its own."""
    record = medium(1)
    return [
        replace(
            measure(TRUTH, record, replace(insertion(depth, angle_sd=0.0), bevel_factor=factor)),
            id=f"{name}{depth:g}",
            specimen=name,
            bevel_factor=1.0,
        )
        for name, factor in zip(NAMES, factors, strict=True)
        for depth in depths
    ]


def test_repeats_are_depths_of_one_specimen_among_several():
    made = holes()
    assert find_repeats(dataset(made)) == {one.id: (one.specimen, NAMES.index(one.specimen)) for one in made}
    assert find_repeats(dataset(made[:8])) == {}  # four specimens alone
    assert find_repeats(dataset([replace(one, depth=30.0) for one in made])) == {}
    apart = [replace(one, frame=replace(one.frame, origin=np.array([0, one.depth, 0]))) for one in made]
    assert find_repeats(dataset(apart)) == {}
    assert len(find_repeats(dataset(apart, pose="free"))) == len(made)


def test_repeats_have_exact_gradients_and_one_condition_a_hole():
    p = problem(medium(1), holes(), how=LikelihoodRecord(depths="fixed"), noise=FINE)
    theta = p.parameters.theta({**TRUTH, "bevel_spread": 0.07}) + 0.05
    value, gradient = p.gradient(theta)
    assert value == pytest.approx(p.log_posterior(theta), rel=1e-9)
    assert p.log_posteriors(theta[None])[0] == pytest.approx(value, rel=1e-6)
    slope = difference_jacobian(lambda t: np.atleast_1d(p.log_posterior(t)), theta, np.full(len(theta), 1e-4))
    np.testing.assert_allclose(gradient, slope[0], rtol=1e-4)
    found, exact = p.jacobian(theta)
    assert -(found @ exact) == pytest.approx(gradient, rel=1e-6, abs=1e-6)
    rows = sum(known.rows for known in p.density.observations)
    # of each depth one condition that is nobody else's (of weight 0), of each hole the bevel
    assert sum(p.density.residual_counts) == rows + 10 + 5
    alone = replace(p, dataset=replace(p.dataset, insertions=p.insertions[:1]))
    assert alone.log_posterior(theta) != pytest.approx(value, abs=0.5)


BENT = math.log(1.15)
"""Logarithm of the bevel's factor in the last hole."""


@pytest.fixture(scope="module")
def job():
    made = holes(factors=(1.0, 1.0, 1.0, 1.0, math.exp(BENT)))
    record = medium(1)
    p = problem(record, made, how=LikelihoodRecord(depths="fixed"), noise=FINE)
    study = StudyRecord.model_validate(
        {"schema": 2, "dataset": "cases", "medium": "test", "recipe": "default", "leave_out": "specimen"}
    )
    return Job(
        "holes", study, p.dataset, record, p.parameters, RecipeRecord.model_validate({"schema": 2}), None, ()
    )


def predict(job, tune, held):
    """The predicted tips of depths that are held out, in units of the bevel's spread of 0.1."""
    known = [one for one in job.dataset.insertions if one.id in tune]
    wanted = [one for one in job.dataset.insertions if one.id in held]
    theta = job.parameters.theta({**TRUTH, "bevel_spread": 0.1})
    draws = Draws(np.repeat(theta[None], 300, axis=0), "importance")
    rows = predict_held_out(job, Fold("one", tuple(known), tuple(wanted)), draws)
    return [one.row for one in rows]


def test_a_depth_of_a_known_hole_is_predicted_with_the_bevel_of_that_hole(job):
    everything = [one.id for one in job.dataset.insertions]
    (new,) = predict(job, everything[:8], ["E36"])
    (known,) = predict(job, everything[:9], ["E36"])
    width = {name: row["tip_95_high_mm"] - row["tip_95_low_mm"] for name, row in (("n", new), ("k", known))}
    assert width["k"] < 0.5 * width["n"]
    off = [abs(row["tip_median_mm"] - row["tip_measured_mm"]) for row in (known, new)]
    assert off[0] < 0.2 * off[1]


def test_the_depths_of_a_hole_left_out_have_one_bevel(job):
    everything = [one.id for one in job.dataset.insertions]
    shallow, deep = predict(job, everything[:8], ["E32", "E36"])
    tips = [row["tip_median_mm"] / row["tip_measured_mm"] for row in (shallow, deep)]
    assert tips[0] == pytest.approx(tips[1], rel=2e-3)  # 300 independent draws would differ by 1 %
