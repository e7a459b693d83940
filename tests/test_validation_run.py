"""A study on needles whose truth is known: recovered, scored, stopped, resumed to the same frames."""

import math
from dataclasses import replace
from pathlib import Path

import needles
import numpy as np
import pandas as pd
import pytest
from inference_cases import NEEDLE, TRUTH, dataset, insertion, medium, problem, two_layers
from light_runs import predict_by_few_draws
from numpy.testing import assert_allclose
from pytest import approx
from scipy.optimize import brentq
from world import PROJECT

from needlefit import Needle
from needlefit.datasets.select import select_same_needle
from needlefit.errors import ConfigError
from needlefit.geometry.curves import integrate_curvature
from needlefit.geometry.surfaces import make_sheet
from needlefit.inference.draws import Draws
from needlefit.inference.forward_model import predict
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.schemas.study import StudyRecord
from needlefit.studies.fit_warnings import list_outside, tabulate_validity
from needlefit.studies.kinds.cross_validation import run as cross_validation_run
from needlefit.studies.kinds.cross_validation.run import Settings, run
from needlefit.studies.needle_placement import simulate_fitted_draws
from needlefit.studies.score import Scorer, curve_predictor, make_predictors, model_predictor

MEDIUM = (PROJECT / "configs/media/gel.toml").read_text()
RECIPE = """schema = 1
starts = 4
evaluations = 250
tolerance = 1e-6
[sample]
walkers = 8
densities = 240
"""


def made(folder):
    needles.build(folder / "data" / "needles")
    for kind, text in (("media", MEDIUM), ("recipes", RECIPE)):
        (folder / "configs" / kind).mkdir(parents=True)
        (folder / "configs" / kind / "gel.toml").write_text(text)
    return folder


@pytest.fixture
def project(tmp_path, monkeypatch):
    monkeypatch.chdir(made(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """The study as it is, run once."""
    with pytest.MonkeyPatch.context() as here:
        here.chdir(made(tmp_path_factory.mktemp("clean")))
        return run("clean", study(), Settings())


def study(**changes):
    return StudyRecord.model_validate(
        {
            "schema": 1, "dataset": "needles", "medium": "gel", "recipe": "gel",
            "tune": {"specimens": ["piece1"]}, "validate": [{"specimens": ["piece2"]}],
        } | changes
    )  # fmt: skip


def fitted(results):
    rows = results.frames["parameters"][results.frames["parameters"]["method"] == "fitted"]
    return dict(zip(rows["parameter"], rows["value"], strict=True))


def test_truth_is_recovered_and_scored_with_no_error(clean):
    results = clean
    assert fitted(results)["mu1_pa"] == approx(needles.MU[0] * 1e6, rel=0.05)
    assert fitted(results)["bevel_mm"] == approx(needles.BEVEL, rel=0.01)
    errors = results.frames["errors"][results.frames["errors"]["method"] == "fitted"]
    assert set(errors["role"]) == {"tune", "validate"}
    assert errors["te_mm"].max() < 0.01
    assert (errors["deflection_mm"] > 0).all()  # toward the bevel, whichever side it faces
    assert results.frames["starts"]["failed_solves"].sum() == 0
    assert results.origin == "synthetic"


ONE_LAYER = "\n".join(line for line in MEDIUM.splitlines() if "2" not in line.split("=")[0])


@pytest.mark.parametrize(
    ("medium", "changes", "words"),
    [
        (
            MEDIUM,
            {"tune": {"insertions": ["needle-1"]}, "validate": [{"specimens": ["piece1"]}]},
            r"needle-1 .*tune and validate",
        ),
        (MEDIUM.replace("fixed = 2e7", "bounds = [1e3, 1e9]"), {"paper_parameters": "chicken"}, "no mu2_pa"),
        (ONE_LAYER.replace("layers = 2", "layers = 1"), {}, r"gel .*1 layer.* needle-1 .*layer 2"),
        (f"{MEDIUM}\nguide_distance_mm = {{ bounds = [1.0, 120.0] }}\n", {}, "needle of 150 mm"),
    ],
)
def test_what_cannot_be_fitted_is_refused_before_the_fit(project, medium, changes, words):
    (project / "configs/media/gel.toml").write_text(medium)
    with pytest.raises(ConfigError, match=words):
        run("refused", study(**changes), Settings())


STEEP = {**TRUTH, "bevel_mm": 0.9}


def test_parameter_sets_are_outside_where_any_of_their_needles_is():
    problem = two_layers(count=2)
    thetas = [problem.parameters.theta({**TRUTH, "bevel_mm": b}) for b in (0.02, 0.08, 0.5, 0.9)]
    found = simulate_fitted_draws(problem, Draws(np.array(thetas), "importance"), bands=False).outside
    for theta, beyond in zip(thetas, found, strict=True):
        values = problem.values(theta)
        shapes = [predict(values, problem.medium, one) for one in problem.insertions]
        assert beyond == any(shape.converged and not shape.valid for shape in shapes)
    assert not found[0] and found[-1]
    assert simulate_fitted_draws(problem, Draws(np.empty((0, 0)), "importance")).outside.shape == (0,)
    assert all(np.isfinite(problem.objective(theta)) for theta in thetas)  # nothing is penalised


def test_scored_simulations_are_counted_and_named():
    one = insertion(41.0, (25.0,), (1, 2))
    data = dataset([one])
    scorer = Scorer(data, "listed", {one.id: {"te_mm": 0.25}})
    scored = []
    for method, values in (("fitted", TRUTH), ("fitted", STEEP), ("hand_tuned", STEEP)):
        place = {"fold": "all", "role": "tune", "method": method}
        scored += scorer.score(place, one, model_predictor(values, medium()))["outside"]
    assert predict(STEEP, medium(), one).converged
    validity = tabulate_validity([], scored)
    assert [row["method"] for row in scored] == ["fitted", "hand_tuned"] and validity.fitted_outside == 1
    (words,) = list_outside(validity)
    assert words.startswith("1 ")


WRONG = {**TRUTH, "bevel_mm": 0.25, "mu1_pa": 1e6}
FLOOR = {"median_err_mm": 0.1, "ipe_mean_mm": 0.11, "ipe_max_mm": 0.3, "te_mm": 0.25}
ONE_EVALUATION = "schema = 1\nstarts = 3\nevaluations = 1\n[likelihood]\nbevel_spread = 0.0\n"


# ---- measured and planned layers


def oblique(planned):
    """The insertion with the plane x + 2 y = 18 as its layer boundary, whatever was measured."""
    surface = make_sheet("oblique", [18.0, 0, 0], [1.0, 2.0, 0], 300.0, 2)
    return replace(planned, surfaces=(surface,))


def shape_with(planned, boundary):
    return predict(WRONG, medium(), replace(planned, boundaries=np.array([boundary]), sequence=(1, 2)))


def own_crossing(planned):
    """Return the boundary at which the needle through it crosses the plane x + 2 y = 18."""

    def beyond(boundary):
        points = sample_inserted_points(shape_with(planned, boundary), 4001)
        return float(np.interp(boundary, *points[:, :2].T)) * 2.0 + boundary - 18.0

    return float(brentq(beyond, 10.0, 18.0, xtol=1e-9))


@pytest.fixture(scope="module")
def planned():
    """Its measured boundary, 25 mm, is not where a needle of the wrong parameters would cross."""
    return insertion(41.0, (25.0,), (1, 2))


def test_planned_rows_follow_the_simulated_needle_and_measured_ones_what_was_measured(planned):
    curves = model_predictor(WRONG, medium())(oblique(planned))
    s = np.linspace(0, 41, 42)
    crossing = own_crossing(planned)
    assert 14 < crossing < 15
    for kind, boundary in (("measured", 25.0), ("planned", crossing)):
        meant = sample_inserted_points(shape_with(planned, boundary), 42)
        assert_allclose(curves[kind](s), meant, atol=5e-4)
    assert abs(curves["planned"](s)[-1, 1] - curves["measured"](s)[-1, 1]) > 0.5


# ---- one row


def scorer(floor=FLOOR):
    return Scorer(dataset([insertion(10.0)]), "listed", {"at10": floor})


def straight(bend, side=1):
    """A needle of 10 mm whose tip has moved `bend` mm toward the bevel."""
    planar = np.array([[0.0, 0.0], [math.sqrt(100 - bend**2), side * bend]])
    return insertion(10.0, side=side).with_points(planar)


def along_x(scored):
    return lambda s: np.outer(s, [1.0, 0.0, 0.0])


@pytest.mark.parametrize(("bend", "flagged"), [(0.1, True), (0.24, True), (0.26, False), (3.0, False)])
@pytest.mark.parametrize("side", [1, -1])
def test_a_deflection_under_the_floor_of_the_tip_is_flagged(bend, flagged, side):
    (row,) = scorer().score({}, straight(bend, side), curve_predictor(along_x))["errors"]
    assert row["edp_flagged"] is flagged
    unknown = scorer(dict.fromkeys(FLOOR, math.nan))
    (row,) = unknown.score({}, straight(bend, side), curve_predictor(along_x))["errors"]
    assert row["edp_flagged"] is False


def test_each_needle_has_baseline_curves_of_its_own():
    s, thin = np.linspace(0.0, 40.0, 41), Needle(150.0, 1e3, name="thin")
    bent = [
        replace(insertion(40.0).with_points(integrate_curvature(40.0, [kappa], s)), needle=needle)
        for kappa, needle in ((1e-3, NEEDLE), (4e-3, thin), (1e-3, NEEDLE))
    ]
    methods = make_predictors(problem(medium(1), bent[:2]), {}, None)
    for one in bent:
        curve = methods["constant_curvature"](one)["measured"]
        assert_allclose(curve(s)[-1], one.points[-1], atol=1e-3)
    assert select_same_needle(bent, thin) == (bent[1],)
    assert select_same_needle(bent, thin, least=2) == select_same_needle(bent, Needle(1.0, 1.0)) == (*bent,)


def test_a_failed_solve_is_infinitely_wrong_and_not_drawn():
    scored = scorer().score({}, straight(1.0), lambda scored: {"measured": None})
    (row,) = scored["errors"]
    assert row["ipe_mean_mm"] == row["te_mm"] == row["edp_percent"] == math.inf
    assert math.isnan(row["predicted_deflection_mm"])
    assert row["converged"] is False and scored["shapes"] == []


# ---- whole runs


PUBLISHED = {"mu1_pa": 2.2e5, "alpha1": 1.0, "mu2_pa": 3.2e7, "alpha2": -1.0}


METRIC = "schema = 1\nstarts = 2\nmetric = true\n"


@pytest.fixture(scope="module")
def several_fits(tmp_path_factory):
    """A study fitted by both objectives, with the paper's set beside the fits."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made(tmp_path_factory.mktemp("fits")))
        Path("configs/recipes/gel.toml").write_text(METRIC)
        predict_by_few_draws(patch)
        return run("fits", study(paper_parameters="study1"), Settings())


def test_the_papers_set_keeps_everything_but_its_bevel(several_fits):
    frames = several_fits.frames
    sets = {name: rows.set_index("parameter") for name, rows in frames["parameters"].groupby("method")}
    assert sets["hand_tuned"]["value"].to_dict() == {**PUBLISHED, "bevel_mm": 0.085}
    assert sets["hand_tuned"]["status"].unique().tolist() == ["published"]
    assert fitted(several_fits)["mu2_pa"] == 2e7  # the medium's own
    tuned = frames["errors"].query("role == 'tune' and boundaries == 'measured'")
    ipe = tuned.groupby("method")["ipe_mean_mm"].mean()
    assert ipe["fitted"] < ipe["hand_tuned"]


def test_b_alone_leaves_all_else_at_the_median_of_its_prior(several_fits):
    starts = several_fits.frames["starts"].query("fit == 'b_alone'")
    record = several_fits.metadata.medium
    low, high = record.parameters["mu1_pa"].bounds
    assert len(starts) == 2
    assert_allclose(starts["mu1_pa"], math.sqrt(low * high))
    errors = several_fits.frames["errors"].query("boundaries == 'measured' and role == 'validate'")
    assert set(errors.query("method == 'b_alone'")["insertion"]) == set(errors["insertion"])


def test_our_prediction_is_the_fit_through_the_layers_that_it_meets(several_fits):
    errors = several_fits.frames["errors"].query("role == 'validate'").set_index("insertion")
    ours, fit = (errors[errors["method"] == name] for name in ("prediction", "fitted"))
    planned = fit[fit["boundaries"] == ("planned" if (fit["boundaries"] == "planned").any() else "measured")]
    assert_allclose(ours["te_mm"], planned["te_mm"].loc[ours.index])


@pytest.mark.usefixtures("few_draws")
def test_folds_side_by_side_give_the_same_frames_and_stop_alike(project):
    (project / "configs" / "recipes" / "gel.toml").write_text(ONE_EVALUATION)
    record = study(tune={"insertions": ["needle-1", "needle-2"]}, validate=[], leave_out="insertion")
    one, two = (run("loo", record, Settings(jobs=jobs)) for jobs in (1, 2))
    for name, frame in one.frames.items():
        pd.testing.assert_frame_equal(frame, two.frames[name], check_exact=True)
    assert one.metadata == two.metadata and not two.interrupted
    held_out = one.frames["errors"].query("role == 'validate' and method == 'straight'")
    assert held_out["fold"].tolist() == [f"without {name}" for name in held_out["insertion"]]
    stopped = run("loo", record, Settings(jobs=2, stop=lambda: True))
    assert stopped.interrupted and stopped.frames["errors"]["fold"].nunique() <= 1


@pytest.mark.usefixtures("few_draws")
def test_a_tie_shares_its_sources_verdict_times_its_factor(project):
    tied = MEDIUM.replace("mu2_pa = { fixed = 2e7 }", 'mu2_pa = { tie = "50 * mu1_pa" }')
    (project / "configs" / "media" / "gel.toml").write_text(tied)
    rows = run("tied", study(), Settings()).frames["parameters"].set_index("parameter")
    mu1, mu2 = rows.loc["mu1_pa"], rows.loc["mu2_pa"]
    assert mu2["status"] == "tied" and mu2["note"].startswith("tied: 50 * mu1_pa")
    for column in ("value", "low", "high", "interval_low", "interval_high"):
        assert mu2[column] == approx(50 * mu1[column])
    assert (mu1["determined"], mu2["determined"]) == ("only together", "only together")  # a factor above 2
    assert math.isnan(mu2["sd"]) and mu1["sd"] > 0
    assert [mu1["bound_low"], mu1["bound_high"]] == [3e4, 3e6] and math.isnan(mu2["bound_low"])
    assert rows.loc["alpha1", "note"].startswith("fixed") and rows.loc["alpha1", "determined"] == ""


@pytest.mark.usefixtures("few_draws")
def test_a_run_that_is_stopped_while_it_is_repeated_without_a_needle_is_interrupted(project, monkeypatch):
    asked = []

    def list_first(done, job):
        asked.append(done)
        return [job.insertions[0].id]

    monkeypatch.setattr(cross_validation_run, "list_doubtful", list_first)
    found = run("clean", study(), Settings(stop=lambda: bool(asked)))
    assert not asked[0].interrupted and found.interrupted and "effect" not in found.metadata.model_dump()


@pytest.mark.usefixtures("few_draws")
def test_a_run_all_of_whose_needles_are_doubtful_is_complete(project, monkeypatch):
    def list_all(done, job):
        return [insertion.id for insertion in job.insertions]

    monkeypatch.setattr(cross_validation_run, "list_doubtful", list_all)
    found = run("clean", study(), Settings())
    assert not found.interrupted and "effect" not in found.metadata.model_dump()
