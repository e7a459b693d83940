"""What is scored: planned layers, flags, the paper's set with its bevel re-tuned, starts of their own."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from inference_cases import NEEDLE, TRUTH, dataset, insertion, medium
from light_runs import predict_by_few_draws
from scipy.optimize import brentq
from test_validation_run import MEDIUM, fitted, made, project, study

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.noise import NoiseFloor
from needlefit.datasets.read import read
from needlefit.geometry.surfaces import make_sheet
from needlefit.inference.forward_model import predict
from needlefit.mechanics.shape import NeedleShape, sample_inserted_points
from needlefit.reporting.number_format import format_number
from needlefit.studies.job import make_folds
from needlefit.studies.kinds.cross_validation.run import Settings, run
from needlefit.studies.kinds.cross_validation.tables import arrange_parameters, tabulate_parameters
from needlefit.studies.run import Run
from needlefit.studies.score import Scorer, curve_predictor, model_predictor

__all__ = ["project"]  # a fixture

WRONG = {**TRUTH, "bevel_mm": 0.25, "mu1_pa": 1e6}
FLOOR = {"median_err_mm": 0.1, "ipe_mean_mm": 0.11, "ipe_max_mm": 0.3, "te_mm": 0.25}
ONE_EVALUATION = (
    'schema = 1\nalgorithm = "neldermead"\nstarts = 3\nevaluations = 1\n[likelihood]\nbevel_spread = 0.0\n'
)


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
    (row,), _ = scorer(dict.fromkeys(FLOOR, math.nan)).score(
        {}, straight(bend, side), curve_predictor(along_x)
    )
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


METRIC = 'schema = 1\nstarts = 2\nmetric = true\nmetric_algorithm = "slsqp"\n'


@pytest.fixture(scope="module")
def several_fits(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A study fitted by both objectives, with the paper's set beside the fits."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made(tmp_path_factory.mktemp("fits")))
        Path("configs/recipes/gel.toml").write_text(METRIC)
        predict_by_few_draws(patch)
        return run("fits", study(paper_parameters="study1"), Settings())


def test_the_papers_set_keeps_everything_but_its_bevel(several_fits: Run) -> None:
    frames = several_fits.frames
    sets = {name: rows.set_index("parameter") for name, rows in frames["parameters"].groupby("method")}
    paper, retuned = (sets[name]["value"].to_dict() for name in ("hand_tuned", "hand_tuned_b"))
    assert paper == {**PUBLISHED, "bevel_mm": 0.085}
    assert retuned == {**PUBLISHED, "bevel_mm": retuned["bevel_mm"]}
    assert abs(retuned["bevel_mm"] - 0.085) > 1e-3
    assert sets["hand_tuned"]["status"].unique().tolist() == ["published"]
    assert sets["hand_tuned_b"].query("status == 'free'").index.tolist() == ["bevel_mm"]
    starts = frames["starts"][frames["starts"]["fit"] == "hand_tuned_b"]
    assert len(starts) == 2
    for name, value in PUBLISHED.items():
        assert (starts[name] == value).all()
    assert fitted(several_fits)["mu2_pa"] == 2e7  # the medium's own
    tuned = frames["errors"].query("role == 'tune' and boundaries == 'measured'")
    ipe = tuned.groupby("method")["ipe_mean_mm"].mean()
    assert ipe["fitted"] < min(ipe["hand_tuned"], ipe["hand_tuned_b"])


def test_a_second_fit_stands_in_every_table_if_the_recipe_asks_for_it(several_fits: Run) -> None:
    frames, both = several_fits.frames, {"fitted", "fitted_metric"}
    assert all(both <= set(frames[name]["method"]) for name in ("parameters", "errors"))
    minimized = frames["starts"].groupby("fit")["minimized"].unique()
    assert (minimized["fitted"], minimized["fitted_metric"]) == (["posterior"], ["metric"])
    second = frames["parameters"].query("method == 'fitted_metric'").set_index("parameter")["value"]
    assert second["mu2_pa"] == 2e7 and abs(second["bevel_mm"] / fitted(several_fits)["bevel_mm"] - 1) < 0.01
    printed = {row["parameter"]: row for row in arrange_parameters(tabulate_parameters(several_fits))}
    assert printed["bevel_mm"]["fitted_metric"] == format_number(second["bevel_mm"])


@pytest.mark.sweep
def test_every_search_of_every_fold_begins_in_places_of_its_own(project: Path) -> None:
    """With one evaluation a start ends where it began; the bevel alone is free in both searches."""
    (project / "configs" / "recipes" / "gel.toml").write_text(ONE_EVALUATION)
    fixed = MEDIUM.replace("mu1_pa = { bounds = [3e4, 3e6] }", "mu1_pa = { fixed = 3e5 }")
    (project / "configs" / "media" / "gel.toml").write_text(fixed)
    record = study(tune={}, validate=[], leave_out="specimen", paper_parameters="study1")
    starts = run("starts", record, Settings()).frames["starts"]
    assert len(starts) == 2 * 2 * 3
    assert (starts["evaluations"] == 1).all()
    assert starts["bevel_mm"].nunique() == len(starts)
    again = run("starts", record, Settings()).frames["starts"]
    assert again["bevel_mm"].tolist() == starts["bevel_mm"].tolist()
    other = run("starts", record, Settings(seed=7)).frames["starts"]
    assert not set(other["bevel_mm"]) & set(starts["bevel_mm"])


@pytest.mark.sweep
def test_leaving_one_out_scores_each_insertion_once_by_a_fit_to_the_others(project: Path) -> None:
    (project / "configs" / "recipes" / "gel.toml").write_text(ONE_EVALUATION)
    record = study(tune={}, validate=[], leave_out="insertion")
    found = make_folds(record, read(project / "data" / "needles" / "dataset.toml"))
    ids = [f"needle-{n}" for n in (1, 2, 3, 4)]
    assert [fold.name for fold in found] == [f"without {id_}" for id_ in ids]
    assert [[i.id for i in fold.validate] for fold in found] == [[id_] for id_ in ids]
    assert [[i.id for i in fold.tune] for fold in found] == [[i for i in ids if i != id_] for id_ in ids]
    results = run("loo", record, Settings())
    held_out = results.frames["errors"].query(
        "role == 'validate' and method == 'fitted' and boundaries == 'measured'"
    )
    pairs = list(zip(held_out["fold"], held_out["insertion"], strict=True))
    assert pairs == [(f"without {id_}", id_) for id_ in ids]
    tuned = results.frames["errors"].query("role == 'tune' and method == 'straight'")
    assert tuned.groupby("fold")["insertion"].nunique().tolist() == [3, 3, 3, 3]
    design = results.frames["design"].set_index("role")
    assert design.loc["tune", "insertions"] == design.loc["validate", "insertions"] == 4
    assert design.loc["tune", ["depth_min_mm", "depth_max_mm"]].tolist() == [24.0, 41.0]


@pytest.mark.usefixtures("few_draws")
def test_a_tie_shares_its_sources_verdict_times_its_factor(project: Path) -> None:
    tied = MEDIUM.replace("mu2_pa = { fixed = 2e7 }", 'mu2_pa = { tie = "50 * mu1_pa" }')
    (project / "configs" / "media" / "gel.toml").write_text(tied)
    rows = run("tied", study(), Settings()).frames["parameters"].set_index("parameter")
    mu1, mu2 = rows.loc["mu1_pa"], rows.loc["mu2_pa"]
    assert mu2["status"] == "tied" and mu2["note"].startswith("tied: 50 * mu1_pa")
    for column in ("value", "low", "high", "interval_low", "interval_high"):
        assert mu2[column] == pytest.approx(50 * mu1[column])
    assert mu1["determined"] and not mu2["determined"]  # only the tie determines it
    assert math.isnan(mu2["sd"]) and mu1["sd"] > 0
    assert [mu1["bound_low"], mu1["bound_high"]] == [3e4, 3e6] and math.isnan(mu2["bound_low"])
    assert rows.loc["alpha1", "note"].startswith("fixed") and not rows.loc["alpha1", "determined"]
