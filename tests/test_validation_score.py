"""What is scored: planned layers, flags, the paper's set with its bevel re-tuned, starts of their own."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from inference_cases import NEEDLE, TRUTH, dataset, insertion, medium
from scipy.optimize import brentq
from test_validation_run import MEDIUM, fitted, frames, project, study

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.noise import NoiseFloor
from needlefit.datasets.read import read
from needlefit.geometry.surfaces import make_sheet
from needlefit.inference.forward_model import predict
from needlefit.mechanics.shape import NeedleShape, sample_inserted_points
from needlefit.reporting.number_format import format_number
from needlefit.reporting.parameter_table import tabulate_parameters
from needlefit.validation.folds import make_folds
from needlefit.validation.run import Settings, run
from needlefit.validation.score import Scorer, curve_predictor, model_predictor

__all__ = ["project"]  # the fixture

WRONG = {**TRUTH, "bevel_mm": 0.25, "mu1_pa": 1e6}
FLOOR = NoiseFloor(0.1, 0.11, 0.3, 0.25)
ONE_EVALUATION = 'schema = 1\nalgorithm = "neldermead"\nstarts = 3\nevaluations = 1\n'


# ---- measured and planned layers


def oblique(planned: Insertion):
    """The insertion with the plane x + 2 y = 18 as its layer boundary, whatever was measured."""
    surface = make_sheet("oblique", [18.0, 0, 0], [1.0, 2.0, 0], 300.0, 2)
    return dataclasses.replace(planned, surfaces=(surface,))


def shape_with(planned: Insertion, boundary: float) -> NeedleShape:
    return predict(WRONG, medium(), NEEDLE, planned, np.array([boundary]), (1, 2))


def own_crossing(planned: Insertion) -> float:
    """Return the boundary at which the needle through it crosses the plane x + 2 y = 18."""

    def beyond(boundary: float) -> float:
        points = sample_inserted_points(shape_with(planned, boundary), 4001)
        return float(np.interp(boundary, *points.T)) * 2.0 + boundary - 18.0

    return float(brentq(beyond, 10.0, 18.0, xtol=1e-9))


@pytest.fixture(scope="module")
def planned() -> Insertion:
    """Its measured boundary, 25 mm, is not where a needle of the wrong parameters would cross."""
    return insertion(41.0, (25.0,), (1, 2))


def test_planned_rows_follow_the_simulated_needle_and_measured_ones_what_was_measured(planned) -> None:
    curves = model_predictor(WRONG, medium(), dataset([planned]))(oblique(planned))
    s = np.linspace(0, 41, 42)
    crossing = own_crossing(planned)
    assert 14 < crossing < 15
    for kind, boundary in (("measured", 25.0), ("planned", crossing)):
        meant = sample_inserted_points(shape_with(planned, boundary), 42)
        np.testing.assert_allclose(curves[kind](s), meant, atol=5e-4)
    assert abs(curves["planned"](s)[-1, 1] - curves["measured"](s)[-1, 1]) > 0.5


def test_without_surfaces_there_is_nothing_to_plan(planned) -> None:
    assert list(model_predictor(WRONG, medium(), dataset([planned]))(planned)) == ["measured"]


# ---- one row


def scorer(floor: NoiseFloor = FLOOR) -> Scorer:
    return Scorer(dataset([insertion(10.0)]), "listed", {"at10": floor})


def straight(bend: float, side: int = 1) -> Insertion:
    """A needle of 10 mm whose tip has moved `bend` mm toward the bevel."""
    planar = np.array([[0.0, 0.0], [math.sqrt(100 - bend**2), side * bend]])
    return dataclasses.replace(insertion(10.0, side=side), planar=planar)


def along_x(scored: Insertion):
    return lambda s: np.column_stack([s, 0 * s])


@pytest.mark.parametrize(("bend", "flagged"), [(0.1, True), (0.24, True), (0.26, False), (3.0, False)])
@pytest.mark.parametrize("side", [1, -1])
def test_a_deflection_under_the_floor_of_the_tip_is_flagged(bend: float, flagged: bool, side: int) -> None:
    (row,), _ = scorer().score({}, straight(bend, side), curve_predictor(along_x))
    assert row["edp_flagged"] is flagged
    (row,), _ = scorer(NoiseFloor(*[math.nan] * 4)).score({}, straight(bend, side), curve_predictor(along_x))
    assert row["edp_flagged"] is False


@pytest.mark.parametrize("side", [1, -1])
def test_a_row_by_hand(side: int) -> None:
    """The measured needle leaves in a straight line, 6 mm aside in 10; the simulated one stays at y = 1.

    IPE_j = |(2 f, 1 - 6 f)| at fractions f of the length (8 mm against 10 along x).
    """
    flat = curve_predictor(lambda scored: lambda s: np.column_stack([s, np.full_like(s, side * 1.0)]))
    place = {"fold": "all", "role": "validate", "method": "fitted"}
    (row,), points = scorer().score(place, straight(6.0, side), flat)
    f = np.linspace(0, 1, 101)
    ipe = np.hypot(2 * f, 1 - 6 * f)
    assert row["te_mm"] == pytest.approx(math.sqrt(29))
    assert row["edp_percent"] == pytest.approx(100 * math.sqrt(29) / 6)
    assert row["ipe_mean_mm"] == pytest.approx(ipe.mean())
    assert row["ipe_std_mm"] == pytest.approx(ipe.std())
    assert row["ipe_max_mm"] == pytest.approx(math.sqrt(29))
    assert row["median_err_mm"] == pytest.approx(np.median(ipe))
    assert (row["deflection_mm"], row["predicted_deflection_mm"]) == (pytest.approx(6.0), 0.0)
    assert (row["floor_te_mm"], row["floor_ipe_max_mm"], row["converged"]) == (0.25, 0.3, True)
    assert (row["insertion"], row["boundaries"], row["depth_mm"], row["layers"]) == (
        "at10",
        "measured",
        10,
        1,
    )
    assert [p["j"] for p in points] == list(range(101))
    assert points[-1]["measured_x_mm"] == pytest.approx(8.0)
    assert points[-1]["simulated_x_mm"] == pytest.approx(10.0)
    assert points[-1]["measured_y_mm"] == pytest.approx(6.0 * side)
    assert points[-1]["simulated_y_mm"] == side


def test_a_failed_solve_is_infinitely_wrong_and_not_drawn() -> None:
    (row,), points = scorer().score({}, straight(1.0), lambda scored: {"measured": None})
    assert row["ipe_mean_mm"] == row["te_mm"] == row["edp_percent"] == math.inf
    assert math.isnan(row["predicted_deflection_mm"])
    assert row["converged"] is False and points == []


# ---- whole runs


PUBLISHED = {"mu1_pa": 2.2e5, "alpha1": 1.0, "mu2_pa": 3.2e7, "alpha2": -1.0}


def test_the_papers_set_keeps_everything_but_its_bevel(project: Path) -> None:
    results = run("methods", study(paper_parameters="study1"), Settings())
    sets = {name: rows.set_index("parameter") for name, rows in results.parameters.groupby("method")}
    paper, retuned = (sets[name]["value"].to_dict() for name in ("hand_tuned", "hand_tuned_b"))
    assert paper == {**PUBLISHED, "bevel_mm": 0.085}
    assert retuned == {**PUBLISHED, "bevel_mm": retuned["bevel_mm"]}
    assert abs(retuned["bevel_mm"] - 0.085) > 1e-3
    assert sets["hand_tuned"]["status"].unique().tolist() == ["published"]
    assert sets["hand_tuned_b"].query("status == 'free'").index.tolist() == ["bevel_mm"]
    starts = results.starts[results.starts["fit"] == "hand_tuned_b"]
    assert len(starts) == 4
    for name, value in PUBLISHED.items():
        assert (starts[name] == value).all()
    assert fitted(results)["mu2_pa"] == 2e7  # the medium's own
    tuned = results.errors.query("role == 'tune' and boundaries == 'measured'")
    ipe = tuned.groupby("method")["ipe_mean_mm"].mean()
    assert ipe["fitted"] < min(ipe["hand_tuned"], ipe["hand_tuned_b"])


@pytest.mark.parametrize("metric", [True, False])
def test_a_second_fit_stands_in_every_table_if_the_recipe_asks_for_it(project: Path, metric: bool) -> None:
    recipe = f'schema = 1\nstarts = 2\nmetric = {str(metric).lower()}\nmetric_algorithm = "slsqp"\n'
    (project / "configs" / "recipes" / "gel.toml").write_text(recipe)
    results = run("both", study(), Settings())
    both = {"fitted", "fitted_metric"} if metric else {"fitted"}
    assert set(results.starts["fit"]) == set(results.parameters["method"]) == both
    assert set(results.errors["method"]) & {"fitted", "fitted_metric"} == both
    printed = tabulate_parameters(results).set_index("parameter")
    if not metric:
        assert set(printed["fitted_metric"]) == {""}
        return
    minimized = results.starts.groupby("fit")["minimized"].unique()
    assert (minimized["fitted"], minimized["fitted_metric"]) == (["posterior"], ["metric"])
    second = results.parameters.query("method == 'fitted_metric'").set_index("parameter")["value"]
    assert second["mu2_pa"] == 2e7 and abs(second["bevel_mm"] / fitted(results)["bevel_mm"] - 1) < 0.01
    assert printed["fitted_metric_value_used"].to_dict() == second.to_dict()
    assert printed.loc["bevel_mm", "fitted_metric"] == format_number(second["bevel_mm"])


@pytest.mark.slow
def test_every_search_of_every_fold_begins_in_places_of_its_own(project: Path) -> None:
    """With one evaluation a start ends where it began; the bevel alone is free in both searches."""
    (project / "configs" / "recipes" / "gel.toml").write_text(ONE_EVALUATION)
    fixed = MEDIUM.replace("mu1_pa = { bounds = [3e4, 3e6] }", "mu1_pa = { fixed = 3e5 }")
    (project / "configs" / "media" / "gel.toml").write_text(fixed)
    record = study(tune={}, validate=[], leave_out="specimen", paper_parameters="study1")
    starts = run("starts", record, Settings()).starts
    assert len(starts) == 2 * 2 * 3
    assert (starts["evaluations"] == 1).all()
    assert starts["bevel_mm"].nunique() == len(starts)
    again = run("starts", record, Settings()).starts
    assert again["bevel_mm"].tolist() == starts["bevel_mm"].tolist()
    other = run("starts", record, Settings(seed=7)).starts
    assert not set(other["bevel_mm"]) & set(starts["bevel_mm"])


def test_leaving_one_out_scores_each_insertion_once_by_a_fit_to_the_others(project: Path) -> None:
    (project / "configs" / "recipes" / "gel.toml").write_text(ONE_EVALUATION)
    record = study(tune={}, validate=[], leave_out="insertion")
    found = make_folds(record, read(project / "data" / "needles" / "dataset.toml"))
    ids = [f"needle-{n}" for n in (1, 2, 3, 4)]
    assert [fold.name for fold in found] == [f"without {id_}" for id_ in ids]
    assert [[i.id for i in fold.validate] for fold in found] == [[id_] for id_ in ids]
    assert [[i.id for i in fold.tune] for fold in found] == [[i for i in ids if i != id_] for id_ in ids]
    results = run("loo", record, Settings())
    held_out = results.errors.query("role == 'validate' and method == 'fitted' and boundaries == 'measured'")
    pairs = list(zip(held_out["fold"], held_out["insertion"], strict=True))
    assert pairs == [(f"without {id_}", id_) for id_ in ids]
    tuned = results.errors.query("role == 'tune' and method == 'straight'")
    assert tuned.groupby("fold")["insertion"].nunique().tolist() == [3, 3, 3, 3]
    design = results.design.set_index("role")
    assert design.loc["tune", "insertions"] == design.loc["validate", "insertions"] == 4
    assert design.loc["tune", ["depth_min_mm", "depth_max_mm"]].tolist() == [24.0, 41.0]


def test_a_tie_shares_its_sources_verdict_times_its_factor(project: Path) -> None:
    tied = MEDIUM.replace("mu2_pa = { fixed = 2e7 }", 'mu2_pa = { tie = "50 * mu1_pa" }')
    (project / "configs" / "media" / "gel.toml").write_text(tied)
    rows = run("tied", study(), Settings()).parameters.set_index("parameter")
    mu1, mu2 = rows.loc["mu1_pa"], rows.loc["mu2_pa"]
    assert mu2["status"] == "tied" and mu2["note"] == "tied: 50 * mu1_pa"
    for column in ("value", "spread_low", "spread_high"):
        assert mu2[column] == pytest.approx(50 * mu1[column])
    assert mu2["determined"] == mu1["determined"]
    assert math.isnan(mu2["sd"]) and mu1["sd"] > 0
    assert [mu1["bound_low"], mu1["bound_high"]] == [3e4, 3e6] and math.isnan(mu2["bound_low"])
    assert rows.loc["alpha1", "note"].startswith("fixed") and not rows.loc["alpha1", "determined"]


def test_the_run_records_its_settings(project: Path) -> None:
    results = run("run", study(), Settings())
    starts = results.starts
    assert results.run["evaluations"] == starts["evaluations"].sum()
    assert results.run["folds"][0]["validate"] == ["needle-3", "needle-4"]
    search = results.run["searches"]["all"]["fitted"]
    assert search["negative_log_posterior"] == starts["objective"].min()
    assert search["values"] == fitted(results)
    assert json.loads(json.dumps(results.run)) == results.run
    assert [name for name, frame in frames(results).items() if frame.empty] == ["failures"]
