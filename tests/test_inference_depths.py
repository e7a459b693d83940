"""Layer depths by quadrature against brute force, on insertions of the twin near the mode of their fit."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp, ndtri
from scipy.stats import qmc

from needlefit.datasets.read import read
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.marginal import log_marginals
from needlefit.inference.likelihood.observation import make_observation, whiten_residuals
from needlefit.mechanics.shape import compute_positions
from needlefit.project.load import load
from needlefit.project.locate import find_file
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord

TWIN = read(Path(__file__).parents[1] / "data" / "twin" / "dataset.toml")
MEDIUM = load(find_file("medium", "phantom2"), MediumRecord)
MODE = {"mu1_pa": 3.5e5, "mu2_pa": 2.85e7, "mu3_pa": 3.5e5, "mu4_pa": 2.85e7, "bevel_mm": 0.109}
VALUES = {**MODE, "alpha1": 1.0, "alpha2": -1.0, "alpha3": 1.0, "alpha4": -1.0}
DEPTH_SD = 0.1


@cache
def insertion(name):
    (found,) = (one for one in TWIN.insertions if one.id == name)
    return replace(found, depth_sd=DEPTH_SD)


def white(known, one, s):
    return whiten_residuals(known, compute_positions(predict(VALUES, MEDIUM, TWIN.needle, one), s))


@cache
def brute_force(name):
    """The mean likelihood over the prior: 256 draws of the boundaries at each of 5 insertion depths."""
    one = insertion(name)
    known = make_observation(TWIN, one)
    draws = one.boundary_sd * ndtri(qmc.Sobol(len(one.boundaries), seed=5).random(256))
    places, weights = np.polynomial.hermite_e.hermegauss(5)
    squares = np.empty((len(places), len(draws)))
    for i, deep in enumerate(DEPTH_SD * places):
        for j, wrong in enumerate(draws):
            moved = replace(one, depth=one.depth + deep, boundaries=one.boundaries + deep + wrong)
            squares[i, j] = np.sum(white(known, moved, known.nodes.s[0] + deep) ** 2)
    return float(logsumexp(-0.5 * squares, b=weights[:, None]) - np.log(len(draws) * weights.sum()))


def marginal(name, depths):
    known = make_observation(TWIN, insertion(name), likelihood=LikelihoodRecord(depths=depths))
    pairs = zip(known.nodes.insertions, known.nodes.s, strict=True)
    curves = np.array([white(known, one, s) for one, s in pairs])
    return float(log_marginals(curves[None], known.nodes, np.ones(1))[0])


@pytest.mark.parametrize("name", ["phantom2-01", "phantom2-04", "phantom2-08"])
def test_quadrature_gives_the_integral_over_all_depths(name):
    assert marginal(name, "quadrature") == pytest.approx(brute_force(name), abs=0.1)


def test_a_linear_effect_is_not_enough_where_a_stiff_layer_begins_at_a_constraint():
    """Why quadrature exists: the linear likelihood is off by more than 0.3 there, neglect by more than 1."""
    exact = brute_force("phantom2-04")
    assert 0.3 < abs(marginal("phantom2-04", "linear") - exact) < 1.0
    assert abs(marginal("phantom2-04", "fixed") - exact) > 1.0
