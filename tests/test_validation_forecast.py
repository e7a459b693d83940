"""Predictions of planned insertions: what draws and measurement make of them, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from light_runs import do_not_escalate
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from refusals import refusal

import needlefit
from needlefit import Needle, compute_positions
from needlefit.cli.options import scene_record
from needlefit.errors import ConfigError
from needlefit.inference.curve_bands import predict_bands
from needlefit.inference.draws import Draws
from needlefit.inference.identifiability.loosened_assumptions import find_model_error
from needlefit.inference.sampling.posterior import Posterior
from needlefit.project.callbacks import no_note
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.fold_draws import Specimens, choose_specimen
from needlefit.studies.identity import describe_configuration
from needlefit.studies.job import Inputs, Settings, StatedStudy, run_study
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.prediction import run as prediction
from needlefit.studies.kinds.prediction.report import REPORT, find_tip
from needlefit.studies.kinds.prediction.run import (
    draw_parameters,
    forecast,
    list_parameters,
    make_scene,
    require_fitted_kind,
    tabulate_forecast,
)
from needlefit.studies.load import load_study

SCENE = needlefit.open_scene("study2")


@pytest.fixture(scope="module")
def job():
    return prepare_small()


def prepare_small():
    record = load(find_file("fit", "phantom2"), FitRecord).model_copy(update={"recipe": "quick"})
    small = record.tune.model_copy(update={"insertions": ("phantom2-15", "phantom2-16")})
    return load_study("small", record.model_copy(update={"tune": small}), Settings())


def about(thetas, faults=()):
    """Draws about a mode, here the first of them."""
    return Draws(np.array(thetas), "importance", faults, mode=np.array(thetas[0]))


def planned(job, thetas, scene=SCENE, new=False):
    known = Specimens(job, job.folds[0], about(thetas))
    return forecast(scene, known, None if new else job.folds[0].tune[0])


def sure(job):
    """The same, its depths of layers and tip known exactly."""
    exact = tuple(replace(one, depth_sd=0.0, boundary_sd=0.0) for one in job.dataset.insertions)
    return replace(job, dataset=replace(job.dataset, insertions=exact))


def theta(job, **changes):
    values = {"mu1_pa": 2e5, "mu2_pa": 3e7, "mu3_pa": 2e5, "mu4_pa": 3e7, "bevel_mm": 0.08}
    values |= {"alpha1": 1.0, "alpha2": -1.0}
    return job.parameters.theta({**values, "bevel_spread": 1e-9, **changes})


def test_a_turned_needle_is_predicted_in_space_and_its_roll_errs_as_the_dataset_states(job):
    (step,) = SCENE.steps
    turned = replace(step, bevel=replace(step.bevel, offset=0.08, roll_deg=90.0))
    scene = replace(
        SCENE, steps=(replace(turned, depth=20.0, bevel=replace(turned.bevel, roll_deg=0.0)), turned)
    )
    known = sure(job)
    exact = tuple(replace(one, roll_sd=0.0) for one in known.dataset.insertions)
    found = planned(replace(known, dataset=replace(known.dataset, insertions=exact)), [theta(job)] * 3, scene)
    tissue = replace(SCENE.tissue, mu=np.array([0.2, 30.0, 0.2, 30.0]), alpha=np.array([1.0, -1, 1, -1]))
    shape = needlefit.simulate_steps(SCENE.needle, tissue, scene.steps, SCENE.rules)
    expected = compute_positions(shape, found.s)
    assert_allclose(found.across[0], expected[:, 1:], atol=1e-6)
    assert found.needle == approx(expected, abs=1e-6)
    assert tabulate_forecast(found)["needle_95_low_mm"].iloc[-1] == approx(expected[-1, 1], abs=1e-6)
    assert abs(expected[-1, 2]) > 0.5
    tips = planned(known, [theta(job)] * 400, scene).across[:, -1]
    assert np.linalg.norm(tips, axis=1) == approx(np.linalg.norm(expected[-1, 1:]), abs=1e-6)
    angles = np.arctan2(tips[:, 1], tips[:, 0])
    assert np.std(angles) == approx(math.radians(5.0), rel=0.15)
    columns = tabulate_forecast(planned(known, [theta(job)] * 400, scene)).iloc[-1]
    assert columns["needle_z_95_low_mm"] < columns["needle_z_predicted_mm"] < columns["needle_z_95_high_mm"]


def test_an_impossible_prediction_is_refused(job):
    other = replace(SCENE, needle=Needle(150.0, 2e4))
    refusal(ConfigError, "flexural rigidity", require_fitted_kind, other, job)
    deep = replace(
        SCENE.tissue,
        mu=np.full(5, 1.0),
        alpha=np.ones(5),
        boundaries=np.array([5.0, 10, 15, 20]),
        thickness=np.full(5, 40.0),
        friction=np.zeros(5),
    )
    with pytest.raises(ConfigError, match="5 layers"):
        require_fitted_kind(replace(SCENE, tissue=deep), job)


def changed_scene(*assignments):
    return scene_record("study2", None, list(assignments))[1]


@pytest.mark.parametrize(
    "assignments",
    [
        ("rules.constraint_spacing_mm=2",),
        ("rules.advance=path_angle", "bevel.offset_mm=", "bevel.cut_angle_deg=3"),
        ("law=linear",),
        ("layers.2.thickness_mm=20",),
    ],
)
def test_a_scene_that_states_another_rule_than_the_fit_is_refused(job, assignments):
    with pytest.raises(ConfigError) as error:
        make_scene(changed_scene(*assignments), "scene", job.medium)
    assert assignments[0].partition("=")[0] in error.value.what and error.value.fix


def test_a_change_that_draws_would_replace_is_refused(job):
    for key in ("bevel.offset_mm", "layers.1.mu_pa", "layers.2.alpha"):
        record = changed_scene(f"{key}=0.1")
        make_scene(record, "scene", job.medium)
        refusal(ConfigError, key, make_scene, record, "scene", job.medium, [key])
    steps = ({"depth_mm": 10.0}, {"depth_mm": 20.0, "offset_mm": 0.2})
    table = changed_scene().model_dump(by_alias=True, exclude_unset=True) | {"depth_mm": None, "steps": steps}
    with pytest.raises(ConfigError, match=r"steps\.2\.offset_mm"):
        make_scene(SceneRecord.model_validate(table), "scene", job.medium)


def predict_with(job, monkeypatch, draws, inputs=None, depth=38.06, note=no_note, **options):
    for prepare in ("prepare_target", "prepare_with_held_out"):
        monkeypatch.setattr(prediction, prepare, lambda *_: job)
    monkeypatch.setattr(prediction, "draw_parameters", lambda *_: about(draws))
    scene = load(find_file("scene", "study2"), SceneRecord).model_copy(update={"depth_mm": depth})
    record = find_kind("prediction").make_record(target="phantom2", scene=scene, **options)
    return run_study(StatedStudy("gel", record, inputs or Inputs()), Settings(note=note))


def test_a_prediction_follows_a_target_without_spread_between_specimens(job, monkeypatch):
    plain = replace(job, record=job.record.model_copy(update={"specimens": "training only"}))
    found, same, new = (
        predict_with(plain, monkeypatch, [theta(job)] * 20, specimen=one) for one in (None, "same", "new")
    )
    assert [one.metadata.specimen for one in (found, same, new)] == ["training only", "same", "others"]
    within = replace(job, record=job.record.model_copy(update={"same_specimen": True}))
    assert predict_with(within, monkeypatch, [theta(job)] * 20).metadata.specimen == "same"
    widths = [
        one.verdicts[0].numbers["needle_95_high_mm"] - one.verdicts[0].numbers["needle_95_low_mm"]
        for one in (found, same, new)
    ]
    assert widths[2] > 2 * widths[0] and widths[0] == widths[1]


def test_the_parameters_of_a_prediction_are_those_of_the_mean_of_specimens(job, monkeypatch):
    """As a fit states them: draws of all insertions together are of no specimen."""
    mean = theta(job, bevel_mm=0.05)
    monkeypatch.setattr(
        Specimens, "replace_mean", lambda _, draws: replace(draws, thetas=np.tile(mean, (9, 1)))
    )
    rows = predict_with(job, monkeypatch, [theta(job)] * 5).frames["parameters"].set_index("parameter")
    assert rows.loc["bevel_mm", "median"] == approx(0.05)


@pytest.mark.parametrize(("depth", "count"), [(1.1, 0), (1.5, 1), (0.3, 1)])
def test_a_depth_that_was_not_fitted_is_named(job, monkeypatch, depth, count):
    """`depth`: over that of an insertion that was fitted."""
    depth *= job.folds[0].tune[0].depth
    found = predict_with(job, monkeypatch, [theta(job)] * 5, depth=depth)
    assert sum(one.kind == "extrapolation" for one in found.warnings) == count


def test_the_verdict_of_a_run_of_the_same_data_stands_first(job, monkeypatch):
    """Of a run of other data, or another fit, nothing is repeated; that is named before the work."""
    fitted = replace(predict_with(job, monkeypatch, [theta(job)] * 5), name="known")
    first, *others = job.folds[0].tune
    moved = replace(job.folds[0], tune=(replace(first, digest=lambda: "0"), *others))
    other = job.medium.model_copy(update={"thickness_mm": 1.0})
    for changes, named in (
        ({}, ""),
        ({"folds": (moved,)}, f"{first.id} with other data"),
        ({"medium": other}, "tissue"),
    ):
        identity, notes = describe_configuration(replace(job, **changes)).identity, list[str]()
        judged = fitted.with_metadata(identity=identity)
        found = predict_with(job, monkeypatch, [theta(job)] * 5, Inputs(judged=judged), note=notes.append)
        warned = [one for one in found.warnings if one.kind == "data_changed"]
        assert len(warned) == len(notes) == bool(named)
        assert found.metadata.fit_run == (None if named else "known")
        if named:
            assert named in notes[0] and found.metadata.fit_changed in found.first_page.about
            assert found.metadata.fit_verdict is None
        else:
            assert found.metadata.fit_verdict.startswith("known: ")


def test_of_several_specimens_a_name_is_needed(job, monkeypatch):
    """The bevel of the second is 1.5 times as large, and its draws twice as wide; all together are not
    certified."""
    one, two = job.folds[0].tune
    tune = (one, replace(two, specimen="other"))
    apart = replace(sure(job), folds=(replace(job.folds[0], tune=tune),))
    noise, sds = default_rng(3).standard_normal((1000, len(theta(job)))), theta(job) * 0 + 0.01
    sds[job.parameters.free.index("bevel_mm")] = 0.03
    noise[0] = 0.0  # the mode
    drawn = {
        name: about(theta(job, bevel_mm=b) + wider * sds * noise)
        for name, b, wider in ((one.specimen, 0.06, 1.0), ("other", 0.09, 2.0))
    }
    monkeypatch.setattr(Specimens, "_sample_specimen", lambda self, name: drawn[name])
    doubted = about(drawn[one.specimen].thetas[:200], ("not certified",))
    known = Specimens(apart, apart.folds[0], doubted)
    assert choose_specimen(known, "new") is None and choose_specimen(known, "other") is tune[1]
    for wrong in ("same", "third"):
        caught = refusal(ConfigError, "", choose_specimen, known, wrong)
        assert all(name in caught.expected for name in drawn)
    tips = {name: planned(sure(job), list(each.thetas[:300])) for name, each in drawn.items()}
    modes = {name: each.needle[-1, 1] for name, each in tips.items()}
    tips = {name: each.across[:, -1, 0] for name, each in tips.items()}
    assert np.median(tips["other"]) > 1.3 * np.median(tips[one.specimen])
    named = forecast(SCENE, known, tune[1])
    assert named.needle[-1, 1] == approx(modes["other"]) != approx(modes[one.specimen])
    assert np.median(named.across[:, -1, 0]) == approx(np.median(tips["other"]), rel=0.03)
    assert known.faults == known.draws_in(tune[1]).faults == ()


def test_the_mode_of_a_sampled_posterior_is_the_minimum_near_its_best_draw(job):
    names, problem = job.parameters.free, job.problem(job.folds[0])
    values = [job.parameters.values(theta(job, bevel_mm=b)) for b in (0.07, 0.08, 0.09)]
    draws = np.array([[[one[name] for name in names] for one in values]])
    heights = np.array([[problem.log_posterior(theta(job, bevel_mm=b)) for b in (0.07, 0.08, 0.09)]])
    ones = np.ones(len(names) + 1)
    sampled = Posterior(names, draws, heights, ones[:1], ones, ones, wanted=1, burn_in=0, failures=0)
    found = draw_parameters(job, None, Settings(inputs=Inputs(posterior=sampled)))
    assert sampled.best == approx(draws[0, heights[0].argmax()])
    slopes = [problem.log_posterior(found.mode + step * np.eye(len(names))[0]) for step in (-1e-2, 0.0, 1e-2)]
    assert max(slopes) == slopes[1] > heights.max()


def test_the_intervals_of_a_prediction_allow_for_an_error_of_the_model_as_those_of_a_fit(job):
    thetas = theta(job) + 0.05 * default_rng(5).standard_normal((400, len(job.parameters.free)))
    rows = list_parameters(job, about(thetas), job.parameters.values(theta(job)), None)
    problem = job.problem(job.folds[0]).searched
    added = find_model_error(problem, problem.parameters.theta(job.parameters.values(theta(job))))
    for name in ("mu1_pa", "bevel_mm"):
        row = rows.set_index("parameter").loc[name]
        drawn = thetas[:, job.parameters.free.index(name)]
        half_width = np.ptp(np.percentile(drawn, [2.5, 97.5])) / 2
        expected = math.hypot(half_width, 1.96 * added[name])
        assert math.log(row["interval_high"] / row["interval_low"]) / 2 == approx(expected, rel=0.01)
    assert added["bevel_mm"] > 0.05


@pytest.mark.usefixtures("few_draws")
def test_a_prediction_from_an_unconverged_posterior_is_flagged(monkeypatch):
    job = prepare_small()
    short = replace(job, recipe=job.recipe.model_copy(update={"evaluations": 4}))
    monkeypatch.setattr(prediction, "prepare_target", lambda *_: short)
    do_not_escalate(monkeypatch)
    record = find_kind("prediction").make_record(
        target="phantom2", scene=load(find_file("scene", "study2"), SceneRecord), specimen="same"
    )
    found = run_study(StatedStudy("gel", record), Settings())
    layout = REPORT.lay_out(found)[0]
    assert "NOT CERTIFIED" in layout.caption and any("(budget)" in str(one) for one in found.faults)
    tip = find_tip(found)
    assert tip["s_mm"] == SCENE.depth and "(budget)" in found.metadata.not_converged[0]
    assert tip["needle_predicted_mm"] is not None
    assert {tip[f"needle_{level}_{end}_mm"] for level in (50, 95) for end in ("low", "high")} == {None}
    (verdict,) = found.verdicts
    assert verdict.status == "fail" and set(verdict.numbers) == {"s_mm"}


@pytest.mark.parametrize("length", [0.01, 5.0, 1e6])
def test_a_whole_curve_leaves_its_band_at_the_nominal_rate(length):
    """PIT values of curves drawn from the prediction are uniform, whether points are correlated or not.

    The drawn band holds a curve where its PIT value says so.
    """
    rng, s = default_rng(3), np.arange(30.0)
    covariance = 0.04 * np.exp(-np.abs(s[:, None] - s) / length) + 1e-9 * np.eye(30)
    root = np.linalg.cholesky(covariance)
    means = 0.1 * rng.normal(size=(100, 1)) * s
    observed = means[rng.integers(100, size=300)] + rng.normal(size=(300, 30)) @ root.T
    bands = predict_bands(means, covariance, rng)
    levels = np.array([bands.pit(one) for one in observed])
    for level in (0.5, 0.95):  # 300 trials: four standard deviations
        assert np.mean(levels <= level) == approx(level, abs=4 * np.sqrt(level * (1 - level) / 300))
        low, high = bands.ends(level)
        inside = np.all((low <= observed) & (observed <= high), axis=1)
        assert_array_equal(inside, levels <= level)
