"""Predictions of held-out needles: parts of the width; the measured shape is only compared."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from inference_cases import TRUTH, dataset, insertion, measure, medium, problem
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx

from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Noise
from needlefit.datasets.select import find_hole_source, find_repeats, group_insertions, name_holes
from needlefit.inference.draw_simulation import draw_depth_errors, draw_entry_errors, simulate_draws
from needlefit.inference.draws import Draws
from needlefit.inference.forward_model import predict, with_planned_layers
from needlefit.inference.likelihood.nodes import shift_depths
from needlefit.inference.likelihood.observations import make_observation, read_points
from needlefit.inference.likelihood.observations.curvature import surround_sensors
from needlefit.inference.likelihood.pose_errors import pose_sds
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import with_bevel_spread, without_bevel_spread, without_prior
from needlefit.inference.predictive_mixture import PredictiveMixture
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.recipe import LikelihoodRecord, RecipeRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.fold_draws import Specimens, draw_fold_parameters
from needlefit.studies.job import Job, Settings
from needlefit.studies.kinds.cross_validation.rows import FRAMES
from needlefit.studies.load import load_study
from needlefit.studies.observations import predict_held_out
from needlefit.studies.prediction_scores import estimate_width_after_one, find_end_error

POINTS = LikelihoodRecord(depths="fixed", bevel_spread=0.0, measurement="points")


def list_rows(job, fold, draws):
    """Return the rows of all predictions, as if specimens did not differ."""
    record = job.record.model_copy(update={"specimens": "training only"})
    known = Specimens(replace(job, record=record), fold, draws)
    return [one.rows["predictive"][0] for one in predict_held_out(known)]


COPIES = 200  #: draws that are all the same one


@pytest.fixture(scope="module")
def job():
    record = load(find_file("study", "study2"), StudyRecord).model_copy(update={"recipe": "quick"})
    prepared = load_study("small", record, Settings())
    likelihood = prepared.recipe.likelihood.model_copy(update={"bevel_spread": 0.0})
    recipe = prepared.recipe.model_copy(update={"likelihood": likelihood})
    # one bevel and exact ties leave one needle few parameters: importance sampling suffices, in seconds
    return replace(
        prepared, recipe=recipe, parameters=without_prior(without_bevel_spread(prepared.parameters))
    )


@pytest.fixture(scope="module")
def known(job):
    problem = job.problem(job.folds[0])
    fit = minimize(problem, job.recipe, default_rng(1))
    return draw_fold_parameters(job, job.folds[0], fit, Settings()).draws


def predict_alone(values, medium, insertion, s, wrong, deep):
    """One needle through the layers that it meets itself, with errors of depths, mm."""
    met = with_planned_layers(insertion, values, medium)
    moved, at = shift_depths(met, s, deep + wrong[: len(met.boundaries)], deep)
    return read_points(moved, predict(values, medium, moved), at)


def sure(known):
    """One of the draws, as if nothing were open about the parameters."""
    return replace(known, thetas=np.repeat(known.thetas[:1], COPIES, axis=0))


def of(job, *insertions):
    return replace(job.folds[0], validate=insertions)


def exact(insertion):
    return replace(insertion, depth_sd=0.0, boundary_sd=0.0)


def test_with_exact_parameters_and_depths_pose_and_point_errors_remain(job, known):
    insertion = exact(job.folds[0].validate[0])
    (row,) = list_rows(job, of(job, insertion), sure(known))
    shift, angle, _ = pose_sds(insertion, job.dataset.noise)
    half = (row["tip_95_high_mm"] - row["tip_95_low_mm"]) / 2
    least = 1.959964 * np.hypot(shift, angle * insertion.points[-1, 0])
    assert least < half < 1.15 * least  # the points' own noise, and a shift along, are small beside it
    assert tuple(row) == FRAMES["predictive"] and row["draw_source"] == "importance" and row["certified"]
    # of an entry that is the first point, a shift across leaves about half of the turn, whatever its size
    errors = []
    for shift in (0.0, 1.0):
        moved = insertion.with_points(insertion.points + np.array([0.0, shift, 0.0]))
        moved = replace(moved, pose_source="first_point")
        (again,) = list_rows(job, of(job, moved), sure(known))
        half = (again["tip_95_high_mm"] - again["tip_95_low_mm"]) / 2
        least = 1.959964 * angle * insertion.points[-1, 0] / 2
        assert least < half < 1.2 * least
        errors.append(again["tip_measured_mm"] - again["tip_median_mm"])
    assert errors[0] == approx(errors[1], abs=1e-9)


def test_a_path_may_leave_the_medium_a_predicted_needle_may_not(job, known):
    insertion, values = job.folds[0].validate[0], job.parameters.values(known.thetas[0])
    beyond = replace(insertion.surfaces[0], into=job.medium.layers + 1)
    assert with_planned_layers(replace(insertion, surfaces=(beyond,)), values, job.medium) is None


def test_readings_of_curvature_are_predicted_with_the_error_of_their_sensor(job, known):
    insertion, sd = exact(job.folds[0].validate[0]), np.array([1e-4, 2e-4])
    insertion = replace(insertion, curvature=np.column_stack([[5.0, 20.0], np.zeros((2, 2)), sd]))
    values, about = job.parameters.values(known.thetas[0]), surround_sensors(insertion)
    args = job.medium, insertion, about, np.zeros(5), 0.0
    kappa = np.diff(predict_alone(values, *args)[:, 1].reshape(2, 3), n=2)[:, 0]
    insertion.curvature[:, 1] = kappa + sd * (1.9, -2.0)
    record = job.record.model_copy(update={"specimens": "training only"})
    fold = of(job, insertion)
    (one,) = predict_held_out(Specimens(replace(job, record=record), fold, sure(known)))
    found = pd.DataFrame(one.rows["curvature"])
    assert tuple(found) == FRAMES["curvature"] and list(found["kappa_in_95"]) == [True, False]
    assert_allclose(found["kappa_predicted_1_per_mm"], kappa, atol=1e-6)
    assert_allclose(found["kappa_sd_1_per_mm"], sd, rtol=1e-3)


def test_a_bevel_that_varies_between_insertions_widens_it(job, known):
    spread = with_bevel_spread(job.parameters, 0.1)
    thetas = np.column_stack([sure(known).thetas, np.full(COPIES, np.log(0.1))])
    insertion = exact(job.folds[0].validate[0])
    varying = replace(job, parameters=spread)
    (wide,), (one,) = (
        tuple(list_rows(each, of(job, insertion), draws))
        for each, draws in ((varying, replace(known, thetas=thetas)), (job, sure(known)))
    )
    widths = [row["tip_95_high_mm"] - row["tip_95_low_mm"] for row in (wide, one)]
    tips = [row["tip_median_mm"] for row in (wide, one)]
    by_bevel = 2 * 1.959964 * 0.1 * abs(tips[1])  # the tip is all but proportional to b
    assert widths[0] == approx(np.hypot(widths[1], by_bevel), rel=0.15)
    assert tips[0] == approx(tips[1], rel=0.02)


def test_needles_with_depths_of_their_own_are_those_of_single_simulations(job, known):
    insertion, medium = job.folds[0].validate[0], job.medium
    sets = [job.parameters.values(theta) for theta in known.thetas[:300]]
    errors = draw_depth_errors(insertion, len(sets), default_rng(3))
    errors[1][7, 1] = 2.5  # mm: many standard deviations
    sets[40] = {**sets[40], "bevel_mm": 3 * sets[40]["bevel_mm"]}  # far beside all others
    s = np.linspace(10.0, insertion.depth, 5)
    together = simulate_draws(sets, medium, insertion, s, *errors)
    assert together.solved.all() and np.delete(together.valid, 40).all() and len(insertion.surfaces)
    for n in (3, 7, 40, 299):
        deep, wrong = (one[n] for one in errors)
        alone = predict_alone(sets[n], medium, insertion, s, wrong, deep)
        assert together.points[n] == approx(alone, abs=1e-3)
    failing = [*sets[:-1], {**sets[-1], "mu1_pa": np.nan}]
    found = simulate_draws(failing, medium, insertion, s, *errors)
    assert found.solved[:-1].all() and not found.solved[-1]


def test_boundaries_of_needles_may_lie_in_any_order_and_beyond_the_tip():
    rng, s = default_rng(3), np.linspace(0.0, 55.0, 5)
    planned = replace(insertion(55.0, (5.0, 7.0), (1, 2, 1)), boundary_sd=2.0, depth_sd=0.3)  # a thin sheet
    moduli = TRUTH["mu1_pa"] * np.exp(0.3 * rng.standard_normal(40))
    sets = [{**TRUTH, "mu1_pa": mu} for mu in moduli.tolist()]
    deep, wrong = draw_depth_errors(planned, len(sets), rng)
    wrong[:3, :2] = [[3.0, -3.0], [-9.0, 0.0], [0.0, 60.0]]
    drawn = simulate_draws(sets, medium(), planned, s, deep, wrong)
    each = zip(sets, wrong, deep, strict=True)
    alone = [predict_alone(values, medium(), planned, s, *errors) for values, *errors in each]
    assert_allclose(drawn.points, alone, atol=1e-6)
    assert np.ptp(drawn.points[:, -1, 1]) > 1.0


def test_entry_errors_are_few_and_have_their_deviation():
    errors = draw_entry_errors(0.4, 4000, default_rng(1))
    assert len(np.unique(errors)) == 8
    assert [errors.mean(), errors.std()] == approx([0.0, 0.4], abs=0.02)


def test_few_draws_of_a_long_tail_do_not_give_the_end_of_an_interval():
    draws = np.exp(0.8 * default_rng(2).standard_normal(125))
    for means, least, most in ((draws, 0.1, 1.0), (np.linspace(-1, 1, 125), 0.0, 0.03)):
        assert least < find_end_error(PredictiveMixture(means[:, None], np.array([0.02])), 1) < most


def test_the_measured_shape_is_only_compared(job, known):
    insertion = job.folds[0].validate[0]
    bent = replace(insertion, points=insertion.points + np.array([0.0, 5.0, 0.0]))
    (as_is,), (moved,) = (tuple(list_rows(job, of(job, one), sure(known))) for one in (insertion, bent))
    assert moved["tip_median_mm"] == approx(as_is["tip_median_mm"], abs=1e-9)
    assert moved["tip_measured_mm"] == approx(as_is["tip_measured_mm"] + 5.0)
    assert moved["tip_pit"] > 0.99 and not moved["tip_in_95"]
    assert not moved["shape_in_95"] and moved["shape_pit"] > 0.99
    assert moved["tip_crps_mm"] > as_is["tip_crps_mm"] + 3.0


def test_the_noise_scale_is_that_of_the_prediction(job, known):
    insertion = exact(job.folds[0].validate[0])
    doubled = job.recipe.likelihood.model_copy(update={"noise_scale": 2.0})
    wide = replace(job, recipe=job.recipe.model_copy(update={"likelihood": doubled}))
    (one,), (two,) = (tuple(list_rows(each, of(job, insertion), sure(known))) for each in (job, wide))
    widths = [row["tip_95_high_mm"] - row["tip_95_low_mm"] for row in (one, two)]
    points = make_observation(job.dataset, insertion, likelihood=POINTS).point_covariance[-1, -1]
    added = np.diff(np.square(widths))[0]  # the scale is of the points' noise alone, not of the pose's
    assert added == approx((2 * 1.959964) ** 2 * 3 * points, rel=1e-4)


def test_a_known_tip_takes_what_it_shares_with_another_from_its_width():
    rng = default_rng(2)
    shared, own, error = rng.standard_normal((3, 20_000))
    width = estimate_width_after_one(3.0 * shared + 0.4 * own, 3.0 * shared + 0.3 * error)
    # of what is shared, normal of SD 3, SD 0.3 * 3 / hypot(3, 0.3) stays unknown
    assert width == approx(2 * 1.959964 * np.hypot(0.4, 0.9 / np.hypot(3, 0.3)), rel=0.03)


NAMES = ("A", "B", "C", "D", "E")
FINE = Noise(0.0, 0.02, 0.0, 5.0)


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


def test_repeats_are_depths_of_one_hole():
    made = holes()
    assert find_repeats(dataset(made)) == {one.id: (one.specimen, NAMES.index(one.specimen)) for one in made}
    few = made[:8]  # four specimens: where the pose is known, the entry decides
    assert name_holes(dataset(few)) == {one.id: f"{one.specimen}32" for one in few}
    assert group_insertions(dataset(few), few) == tuple(f"{one.specimen}32" for one in few)
    assert find_repeats(dataset(few, pose="free")) == {}
    stated = [replace(one, hole=f"{number % 2}", specimen="piece") for number, one in enumerate(few)]
    for pose in ("known", "free"):
        assert set(name_holes(dataset(stated, pose=pose)).values()) == {few[0].id, few[1].id}
    kinds = (dataset(few), dataset(made, pose="free"), dataset(few, pose="free"), dataset(stated))
    found = [find_hole_source(one, one.insertions[0].medium) for one in kinds]
    assert found == ["entry", "assumed", "separate", "stated"]
    partly = [replace(one, hole="") for one in stated[:2]] + stated[2:]
    assert len(set(name_holes(dataset(partly)).values())) == 4
    assert find_repeats(dataset([replace(one, depth=30.0) for one in made])) == {}
    apart = [replace(one, frame=replace(one.frame, origin=np.array([0, one.depth, 0]))) for one in made]
    assert find_repeats(dataset(apart)) == {}
    assert len(find_repeats(dataset(apart, pose="free"))) == len(made)


BENT = math.log(1.15)  #: logarithm of the bevel's factor in the last hole


@pytest.fixture(scope="module")
def holes_job():
    made = holes(factors=(1.0, 1.0, 1.0, 1.0, math.exp(BENT)))
    record = medium(1)
    p = problem(record, made, how=LikelihoodRecord(depths="fixed"), noise=FINE)
    study = StudyRecord.model_validate(
        {"schema": 2, "dataset": "cases", "medium": "test", "recipe": "default", "leave_out": "specimen"}
    )
    return Job(
        "holes",
        study,
        p.dataset,
        record,
        p.parameters,
        RecipeRecord.model_validate({"schema": 2}),
        None,
        (),
        p.dataset,
    )


def predict_holes(holes_job, tune, held):
    """The predicted tips of depths that are held out, in units of the bevel's spread of 0.1."""
    known = [one for one in holes_job.dataset.insertions if one.id in tune]
    wanted = [one for one in holes_job.dataset.insertions if one.id in held]
    theta = holes_job.parameters.theta({**TRUTH, "bevel_spread": 0.1})
    draws = Draws(np.repeat(theta[None], 300, axis=0), "importance")
    return list_rows(holes_job, Fold("one", tuple(known), tuple(wanted)), draws)


def test_a_depth_of_a_known_hole_is_predicted_with_the_bevel_of_that_hole(holes_job):
    everything = [one.id for one in holes_job.dataset.insertions]
    (new,) = predict_holes(holes_job, everything[:8], ["E36"])
    (known,) = predict_holes(holes_job, everything[:9], ["E36"])
    width = {name: row["tip_95_high_mm"] - row["tip_95_low_mm"] for name, row in (("n", new), ("k", known))}
    assert width["k"] < 0.5 * width["n"]
    off = [abs(row["tip_median_mm"] - row["tip_measured_mm"]) for row in (known, new)]
    assert off[0] < 0.2 * off[1]
