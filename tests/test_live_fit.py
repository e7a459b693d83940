"""The live fit of the page: its mode is the posterior's, its draws lie about it, and moved points move it."""

from functools import cache

import numpy as np
import pytest

from needlefit.inference.sampling.importance import sample_about_modes, sample_by_importance
from needlefit.inference.sampling.log_density import Evaluator, approximate_by_laplace
from needlefit.schemas.medium import ParameterRecord
from needlefit.viewer.live_fit import (
    EFFORT,
    KNOTS,
    SHOWN_DRAWS,
    LiveMode,
    _free_medium,
    draw_about,
    find_mode,
    move_points,
    select_insertions,
    show_moved,
)
from needlefit.viewer.opening import open_target
from needlefit.viewer.viewed_scene import ShownInsertion


def shown() -> ShownInsertion:
    return open_target("twin/phantom2-05").shown


@cache
def mode() -> LiveMode:
    return find_mode(shown(), select_insertions(shown(), "insertion"))


def test_the_mode_is_a_maximum_of_the_posterior() -> None:
    problem, theta = mode().problem, mode().minimum.theta
    top, slope = problem.gradient(theta)
    assert np.max(np.abs(slope)) < 0.1
    rng = np.random.default_rng(2)
    near = theta + 0.02 * rng.standard_normal((20, len(theta)))
    assert np.all(problem.log_posteriors(near) < top)
    assert mode().values["bevel_mm"] == pytest.approx(
        0.1, rel=0.15
    )  # the synthetic needle's own is about that


@pytest.mark.sweep
def test_draws_lie_about_the_mode() -> None:
    found = draw_about(mode(), shown().insertion, 1)
    assert len(found.spread) == SHOWN_DRAWS and found.certified and found.ess >= 100
    assert found.spread.mu.shape == (SHOWN_DRAWS, 4)
    assert np.quantile(found.bevel, 0.05) < mode().values["bevel_mm"] < np.quantile(found.bevel, 0.95)
    again = draw_about(mode(), shown().insertion, 1)
    assert np.array_equal(again.mu, found.mu)


@pytest.mark.sweep
def test_draws_about_the_information_of_the_search_have_the_evidence_of_others() -> None:
    found = find_mode(shown(), select_insertions(shown(), "specimen")[:4])
    problem, minimum, rng = found.problem, found.minimum, np.random.default_rng
    fast = sample_about_modes(problem, [minimum], rng(1), efforts=(EFFORT,))
    density, bounds = Evaluator(problem, 1), (problem.lower, problem.upper)
    about = approximate_by_laplace(density, minimum.theta, *bounds)
    slow = sample_by_importance(density, [about], bounds, rng(1), (EFFORT,))
    assert fast.certified and slow.certified
    assert fast.log_evidence == pytest.approx(slow.log_evidence, abs=0.1)
    means = [np.exp(one.log_weights) @ one.thetas for one in (fast, slow)]
    assert means[0] == pytest.approx(means[1], abs=0.03)


def test_points_that_are_not_moved_are_the_measured_ones() -> None:
    measured = shown()
    assert move_points(measured, [0.0] * KNOTS) is measured


def test_moved_points_keep_their_likelihood() -> None:
    """A shift of all by 1e-6 mm hardly changes the posterior: the cross-sections move with the points."""
    before = find_mode(shown(), select_insertions(shown(), "insertion"))
    near = move_points(shown(), [1e-6] * KNOTS)
    after = find_mode(near, select_insertions(near, "insertion"))
    assert after.values["bevel_mm"] == pytest.approx(before.values["bevel_mm"], rel=1e-4)
    assert after.values["mu1_pa"] == pytest.approx(before.values["mu1_pa"], rel=1e-3)
    assert after.minimum.value == pytest.approx(before.minimum.value, abs=1e-2)


@pytest.mark.sweep
def test_points_that_are_moved_move_the_fit() -> None:
    original = shown().insertion
    ramp = np.linspace(0, 0.3, KNOTS)
    moved = move_points(shown(), ramp.tolist())
    assert moved.insertion.planar[:, 0] == pytest.approx(original.planar[:, 0])
    assert moved.insertion.planar[-1, 1] - original.planar[-1, 1] == pytest.approx(0.3)
    step = original.frame.to_local(moved.insertion.sections.points) - original.frame.to_local(
        original.sections.points
    )
    assert step[-1] == pytest.approx([0, 0.3, 0]) and step[original.sections.s < 0] == pytest.approx(0.0)
    other = find_mode(moved, select_insertions(moved, "insertion"))
    assert other.values["bevel_mm"] != pytest.approx(mode().values["bevel_mm"], rel=1e-3)
    overlay = show_moved(open_target("twin/phantom2-05"), moved).measured
    before = open_target("twin/phantom2-05").measured
    assert overlay.points[-1, 1] - before.points[-1, 1] == pytest.approx(0.3, abs=0.02)


def test_more_insertions_of_the_same_medium_are_fitted_together() -> None:
    counts = [len(select_insertions(shown(), scope)) for scope in ("insertion", "specimen", "dataset")]
    assert counts[0] == 1 <= counts[1] <= counts[2] and counts[2] > 5
    some = select_insertions(shown(), "dataset")
    assert some[0] is not None and {one.medium for one in some} == {shown().insertion.medium}
    assert len({one.id for one in some}) == len(some)


def test_a_medium_with_nothing_free_gets_moduli_and_b_free() -> None:
    medium = shown().medium
    fixed = {name: ParameterRecord(fixed=value) for name, value in shown().values.items()}
    freed = _free_medium(medium.model_copy(update={"parameters": fixed})).parameters
    free = {name for name, one in freed.items() if one.bounds is not None}
    assert free == {"mu1_pa", "mu2_pa", "mu3_pa", "mu4_pa", "bevel_mm"}
    assert _free_medium(medium) is medium
