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
from needlefit.inference.likelihood.nodes import make_group
from needlefit.inference.likelihood.observation import make_observation, whiten_residuals
from needlefit.mechanics.shape import compute_positions
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord

MEDIUM = load(find_file("medium", "phantom2"), MediumRecord)
MODE = {"mu1_pa": 2.18e5, "mu2_pa": 4.07e7, "mu3_pa": 2.55e5, "mu4_pa": 3.4e7, "bevel_mm": 0.103}
VALUES = {**MODE, "alpha1": 1.0, "alpha2": -1.0, "alpha3": 1.0, "alpha4": -1.0}
DEPTH_SD = 0.1


@cache
def twin():
    return read(Path(__file__).parents[1] / "data" / "twin" / "dataset.toml")


@cache
def insertion(name):
    (found,) = (one for one in twin().insertions if one.id == name)
    return replace(found, depth_sd=DEPTH_SD)


def white(known, one, s):
    return whiten_residuals(known, compute_positions(predict(VALUES, MEDIUM, twin().needle, one), s))


@cache
def brute_force(name):
    """The mean likelihood over 1024 draws of the boundaries and the insertion depth from their prior."""
    one = insertion(name)
    known = make_observation(twin(), one)
    draws = ndtri(qmc.Sobol(len(one.boundaries) + 1, seed=5).random(1024))
    squares = []
    for draw in draws:
        deep, wrong = DEPTH_SD * draw[-1], one.boundary_sd * draw[:-1]
        moved = replace(one, depth=one.depth + deep, boundaries=one.boundaries + deep + wrong)
        squares.append(np.sum(white(known, moved, known.nodes.s[0] + deep) ** 2))
    return float(logsumexp(-0.5 * np.array(squares)) - np.log(len(draws)))


def marginal(name, depths):
    known = make_observation(twin(), insertion(name), likelihood=LikelihoodRecord(depths=depths))
    pairs = zip(known.nodes.insertions, known.nodes.s, strict=True)
    curves = np.array([white(known, one, s) for one, s in pairs])
    return float(log_marginals([curves[None]], make_group(known.nodes), np.ones(1), np.zeros(1))[0])


@pytest.mark.parametrize(
    "name", ["phantom2-04", *(pytest.param(f"phantom2-{n}", marks=pytest.mark.sweep) for n in ("07", "09"))]
)
def test_quadrature_gives_the_integral_over_all_depths(name):
    assert marginal(name, "quadrature") == pytest.approx(brute_force(name), abs=0.1)


def test_depths_taken_as_stated_where_a_stiff_layer_begins_at_a_constraint_are_far_off():
    exact = brute_force("phantom2-08")
    assert abs(marginal("phantom2-08", "quadrature") - exact) < 0.1
    assert abs(marginal("phantom2-08", "linear") - exact) < 0.2
    assert abs(marginal("phantom2-08", "fixed") - exact) > 5.0
