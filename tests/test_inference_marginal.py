"""Uncertain depths, bevels and poses, of one insertion and of several: closed forms, and brute force."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, assert_one_density, insertion, measure, medium, problem
from numpy.random import default_rng
from pytest import approx
from research.simulated_data import draw_boundary_errors
from scipy.stats import multivariate_normal

from needlefit.datasets.insertion import Noise
from needlefit.inference.likelihood.marginal import linearize_residuals, log_marginals, solve_shared
from needlefit.inference.likelihood.nodes import DEPTH_STEPS_SD, group_nodes, make_nodes
from needlefit.schemas.recipe import LikelihoodRecord

LINE = np.linspace(0.0, 40.0, 41)


def white_of(curve, axes=3):
    """Residuals (m, R) at the nodes of a function of t (d,)."""
    points = [np.zeros(axes), *(x * np.eye(axes)[j] for j in range(axes) for x in DEPTH_STEPS_SD)]
    return np.array([curve(t) for t in points])


def residuals_of(whites, group, at):
    """Residuals (R + D,) and log det, for residuals that depend on no parameter."""
    by = [np.zeros((*white.shape, 1)) for white in whites]
    found = linearize_residuals(whites, by, group, at, np.zeros(1))
    return found[0][0], found[1][0]


SPREAD = 0.3
AT = np.array([1.3]), np.array([SPREAD])  # scale of the noise, and spread
FLAT = replace(insertion(40.0, (12.0, 20.0), (1, 2, 3)), boundary_sd=0.15)


ROWS = 6  #: residuals of an insertion


def linear_case(seed):
    """Three insertions, two of one specimen: nodes, residuals at them, and what makes their covariance."""
    rng = default_rng(seed)
    insertions = [replace(FLAT, id=name, specimen=name[0]) for name in ("a1", "a2", "b1")]
    made = tuple(make_nodes(one, LINE, "linear", bevel=True, constants=1) for one in insertions)
    first, slopes = rng.normal(size=(3, ROWS)), 0.4 * rng.normal(size=(3, ROWS, 2))
    bevel, pose = rng.normal(size=(3, ROWS)), rng.normal(size=(3, ROWS))
    whites = [
        np.vstack(
            [
                white_of(lambda t, k=k: first[k] + slopes[k] @ t, 2),
                first[k] + np.outer([-0.1, 0.1], bevel[k]),
                pose[k],
            ]
        )
        for k in range(3)
    ]
    return made, whites, (first, slopes, bevel, pose)


def exact_covariance(parts, scale):
    """Of the residuals of all three insertions, with a shared part of 0.1 mm of 0.15 mm in the first two."""
    _, slopes, bevel, pose = parts
    total = np.zeros((3, ROWS, 3, ROWS))
    for k in range(3):
        own = slopes[k] @ slopes[k].T + SPREAD**2 * np.outer(bevel[k], bevel[k]) + np.outer(pose[k], pose[k])
        total[k, :, k] = scale**2 * np.eye(ROWS) + own
    total[0, :, 1] = (0.1 / 0.15) ** 2 * slopes[0] @ slopes[1].T
    total[1, :, 0] = total[0, :, 1].T
    return total.reshape(3 * ROWS, 3 * ROWS)


def shared_case(bevels, centred):
    """The three insertions with the named bevels, which may sum to zero, and the exact covariance."""
    made, whites, parts = linear_case(7)
    made = tuple(one.share_bevel((name, 0)) for one, name in zip(made, bevels, strict=True))
    same = np.equal.outer(list(bevels), list(bevels)).astype(float)
    apart = same - centred / len(set(bevels)) - np.eye(3)  # what `exact_covariance` has is independent
    more = np.einsum("ij,ir,js->irjs", SPREAD**2 * apart, parts[2], parts[2]).reshape(18, 18)
    return made, whites, exact_covariance(parts, 1.3) + more, parts


@pytest.mark.parametrize(
    ("bevels", "centred"), [("abc", True), ("abb", True), ("aaa", True), ("abc", False), ("aab", False)]
)
def test_bevels_that_are_shared_or_sum_to_zero_have_the_density_of_their_covariance(bevels, centred):
    made, whites, covariance, parts = shared_case(bevels, centred)
    groups, got, by_residuals = group_nodes(made, centred), 0.0, -18 * math.log(1.3)
    if centred:
        ((members, group),) = groups
        assert members == (0, 1, 2)
        assert group.bevels.sum() == len(set(bevels))
    for members, group in groups:
        many = [whites[k][None] for k in members]
        got += log_marginals(many, group, *AT)[0]
        residuals, log_det = residuals_of(many, group, AT)
        by_residuals -= 0.5 * (residuals @ residuals + log_det)
    exact = multivariate_normal(cov=covariance).logpdf(parts[0].ravel())
    assert got - 9 * math.log(2 * math.pi) == approx(exact, abs=1e-9)
    assert by_residuals == approx(got, abs=1e-9)


def test_what_insertions_share_has_the_posterior_of_the_joint_gaussian():
    made, whites, parts = linear_case(7)
    ((members, group), _) = group_nodes(made)
    assert members == (0, 1)
    covariance = exact_covariance(parts, 1.3)[:12, :12]
    columns = 0.1 / 0.15 * np.concatenate(parts[1][:2])
    weights = np.linalg.solve(covariance, columns).T
    mean, left = solve_shared([white[None] for white in whites[:2]], group, *AT)
    assert mean[0] == approx(-weights @ parts[0][:2].ravel())
    assert left[0] == approx(np.eye(2) - weights @ columns)


@pytest.mark.parametrize(
    ("depths", "pose", "noise_scale"),
    [("linear", "known", 0.8), ("linear", "free", "estimated"), ("fixed", "known", "estimated")],
)
def test_bevels_that_differ_have_exact_gradients_and_residuals(depths, pose, noise_scale):
    record = medium()
    made = [
        replace(
            measure(TRUTH, record, insertion(d, (9.2, 17.0), (1, 2, 1), side)),
            specimen="one",
            boundary_sd=0.15,
            depth_sd=0.1,
        )
        for d, side in ((32.3, 1), (38.0, -1))
    ]
    how = LikelihoodRecord(depths=depths, noise_scale=noise_scale)
    p = problem(record, made, how=how, pose=pose, noise=Noise(0.19, 0.02, 0.05, 5.0))
    theta = p.parameters.theta({**TRUTH, "bevel_spread": 0.07}) + 0.05
    for asked in (p, replace(p, centred_bevels=False)):
        assert_one_density(asked, theta, rtol=1e-4 if pose == "free" else 1e-5)
    # but for the normalising one, the spread's prior
    assert sum(p.density.residual_counts) == len(p.jacobian(theta)[0]) - 3


def test_errors_of_a_boundary_are_shared_in_part_by_insertions_of_a_specimen():
    planned, rng = replace(FLAT, boundary_sd=0.5, boundary_shared_sd=0.3), default_rng(1)
    drawn = []
    for _ in range(4000):
        shared = {}
        drawn.append([draw_boundary_errors(planned, shared, rng)[0] for _ in range(2)])
    assert np.cov(np.transpose(drawn)) == approx(np.array([[0.25, 0.09], [0.09, 0.25]]), abs=0.02)
