"""What every inquiry rests on: pieces that are kept, answers that are stored, evidence that is rounded."""

import json
import math
import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal

from needlefit.datasets.read import read
from needlefit.errors import ConfigError
from needlefit.inference.baseline_fit import CurveDensity
from needlefit.inference.baselines import COEFFICIENT_LENGTH_MM
from needlefit.inference.forward_model import PreparedModel, make_batch, make_options, predict
from needlefit.inference.likelihood.observation import points_covariance
from needlefit.inference.parameters import (
    BEVEL_SPREAD,
    BEVEL_SPREAD_BOUNDS,
    NOISE_SCALE,
    Parameters,
    choose_hyperparameters,
    with_bevel_spread,
)
from needlefit.inference.problem import Problem
from needlefit.inference.specimens import (
    MIN_SPREAD,
    TransferProblem,
    TransferredPrior,
    widen_posterior,
)
from needlefit.mechanics.batch import simulate_batches
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.metrics import METRICS, list_metrics
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.locate import find_file
from needlefit.schemas.recipe import LikelihoodRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Fold, Job, Settings
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.adaptation import (
    AdaptationRecord,
    AdaptationTask,
    Resampling,
    draw_orders,
    estimate,
    estimate_needed_count,
    plan,
)
from needlefit.studies.kinds.comparison import (
    MAX_NOISE_FACTOR,
    ComparisonRecord,
    candidate_job,
    deal_folds,
    fit_candidate,
    monte_carlo_error,
    sum_differences,
    verdict,
)
from needlefit.studies.kinds.comparison import REPORT as COMPARISON_REPORT
from needlefit.studies.kinds.comparison import plan as plan_comparison
from needlefit.studies.kinds.seeds import UNEXPLAINED, bootstrap_interval, compare_methods, explain_losses
from needlefit.studies.kinds.sensitivity import REPORT, VariationRecord, apply_variation
from needlefit.studies.paper_cells import (
    generalisation_threshold,
    prepare_jobs,
    tabulate_cells,
    tabulate_generalisation,
)
from needlefit.studies.reference import round_frame
from needlefit.studies.runner import run_analysis, run_tasks
from needlefit.studies.simulated_data import simulate_measurement
from needlefit.studies.study_files import load_study
from needlefit.synthetic.build import build_unscanned
from needlefit.synthetic.design import select_planned_insertions
from tests.inference_cases import NEEDLE, NOISE, dataset, insertion, measure, medium, squares_recipe

THIRD = 1 / 3
RECIPE = (Path(__file__).parent.parent / "configs/recipes/quick.toml").read_text(encoding="utf-8")


def _pieces(done: list[str]):
    def piece(key: str, value: float):
        def compute():
            done.append(key)
            return {
                "errors": [{"of": key, "te_mm": value}],
                **({"more": [{"of": key}]} if key == "b" else {}),
            }

        return compute

    values = {"a": THIRD, "b": np.float64(2 / 3), "c": float("inf"), "d": float("nan")}
    return {key: piece(key, value) for key, value in values.items()}


def _stopping_after(count: int, done: list[str]) -> Settings:
    return Settings(stop=lambda: len(done) >= count)


def test_interrupted_tasks_resume_to_the_same_rows(tmp_path):
    whole = list(run_tasks(_pieces([]), "x", Settings(), open_checkpoint(None, False, {})))
    assert [part["errors"][0]["of"] for part in whole] == ["a", "b", "c", "d"]
    assert whole[0]["errors"][0]["te_mm"] == THIRD and type(whole[1]["errors"][0]["te_mm"]) is float
    first: list[str] = []
    kept = open_checkpoint(tmp_path, False, {"work": 1})
    part = list(run_tasks(_pieces(first), "x", _stopping_after(3, first), kept))
    assert part == whole[:2]  # the third was caught half done
    second: list[str] = []
    again = list(run_tasks(_pieces(second), "x", Settings(), open_checkpoint(tmp_path, True, {"work": 1})))
    assert second == ["c", "d"]
    assert json.dumps(again) == json.dumps(whole)


class _BackwardPool:
    """Finishes the last task first; stops after so many."""

    remote = False

    def __init__(self, count: int) -> None:
        self._count = count

    def run(self, work, items, stop):
        for n in reversed(range(len(items))[-self._count :]):
            yield n, work(items[n])


@pytest.mark.parametrize(("count", "of"), [(4, "abcd"), (2, "cd")])
def test_rows_come_in_the_order_of_tasks_that_finish_in_another(count, of):
    parts = run_tasks(_pieces([]), "x", Settings(pool=_BackwardPool(count)), open_checkpoint(None, False, {}))
    assert [part["errors"][0]["of"] for part in parts] == list(of)


def test_a_task_row_keeps_no_value_that_json_would_change():
    tasks = {"a": lambda: {"x": [{"at": Path()}]}}
    with pytest.raises(TypeError, match="Path"):
        list(run_tasks(tasks, "x", Settings(), open_checkpoint(None, False, {})))


def test_evidence_is_rounded_to_five_decimals_of_a_length_and_five_digits():
    frame = pd.DataFrame(
        {
            "te_mm": [0.1234567, -0.000002, np.inf],
            "mu1_pa": [123456.0, 0.0, np.nan],
            "edp_percent": [12.34567, 0.001234567, 1e9 / 3],
            "insertions": [7, 8, 9],
            "note": ["a", "b", "c"],
        }
    )
    got = round_frame(frame)
    assert got["te_mm"].tolist() == [0.12346, 0.0, np.inf]
    assert str(got["te_mm"][1]) == "0.0"
    assert got["mu1_pa"].tolist()[:2] == [123460.0, 0.0] and np.isnan(got["mu1_pa"][2])
    assert got["edp_percent"].tolist() == [12.346, 0.0012346, 3.3333e8]
    assert got[["insertions", "note"]].equals(frame[["insertions", "note"]])


NEXT = {
    "schema": 1,
    "kind": "next_insertion",
    "dataset": "twin",
    "medium": "chicken",
    "recipe": "quick",
    "template_insertion": "chicken-02",
    "tune": {"insertions": ["chicken-01"]},
    "depths_mm": [40.0],
    "entries": [{"name": "above"}],
}
DEEP = [{"name": "a", "entry": "above", "depth_mm": 4e3}]
ALONE = {
    "schema": 1,
    "kind": "comparison",
    "dataset": "twin",
    "medium": "chicken",
    "insertions": {"insertions": ["chicken-01"]},
}

SIDES = {"medium": "chicken", "insertions": {"insertions": ["chicken-01"]}}
ADAPTED = {
    "schema": 1,
    "kind": "adaptation",
    "dataset": "twin",
    "old": SIDES,
    "new": {**SIDES, "insertions": {"insertions": ["chicken-02"]}, "held_out": ["chicken-02"]},
    "counts": [0],
    "between_media": {"ln_mu_sd": 0.6, "ln_bevel_sd": 0.6, "source": "none"},
}


@pytest.mark.parametrize(
    ("record", "what", "where"),
    [
        ({**NEXT, "template_insertion": "none"}, "dataset", "template_insertion"),
        ({**NEXT, "depths_mm": [40, 9e3]}, "9000 mm", "depths_mm"),
        ({**NEXT, "quantities": DEEP}, "4000 mm", "quantities.1.depth_mm"),
        (ALONE, "one group", "folds"),
        ({**ADAPTED, "old": {**SIDES, "insertions": {"insertions": ["x"]}}}, "x", "old.insertions"),
        ({**ADAPTED, "new": {**ADAPTED["new"], "held_out": ["x"]}}, "x", "new.held_out"),
    ],
    ids=["like", "depths", "quantities", "folds", "old", "held_out"],
)
def test_a_faulty_study_is_reported_with_its_name_and_key(record, what, where):
    with pytest.raises(ConfigError, match=what) as error:
        kind = find_kind(record["kind"])
        kind.run("mine", kind.record.model_validate(record), Settings())
    assert f"study mine, key `{where}" in f"{error.value.where}, key `{error.value.key}`"


@pytest.fixture(scope="module")
def job() -> Job:
    return prepare_jobs(["study2"], [], Settings())["study2"]


def vary(job: Job, **changes: object) -> Job:
    return apply_variation(job, VariationRecord(factor="x", name="y", **changes))


def test_a_variation_changes_what_it_names_and_nothing_else(job):
    changed = vary(job, constraint_switch=0.0, first_cell_mm=0.5, thickness_mm=20.0, boundary_shift_sd=2.0)
    now, before = make_options(changed.medium), make_options(job.medium)
    assert (now.switch, now.tangent, now.first_cell, now.spacing) == (0.0, 1.0, 0.5, before.spacing)
    assert changed.medium.thickness_mm == 20.0 and changed.dataset.needle == job.dataset.needle
    for one, other in zip(changed.insertions, job.insertions, strict=True):
        np.testing.assert_allclose(one.boundaries, other.boundaries + 2 * other.boundary_sd)
        assert one.sequence == other.sequence


def test_the_path_angle_takes_the_place_of_b_and_is_tuned_again(job):
    changed = vary(job, advance="path_angle")
    assert make_options(changed.medium).path_angle and changed.medium.law == job.medium.law
    renamed = ["cut_angle_deg" if name == "bevel_mm" else name for name in job.parameters.free]
    assert list(changed.parameters.free) == renamed and changed.parameters.ties == job.parameters.ties
    values = {**job.hand_tuned, "cut_angle_deg": 3.0}
    assert predict(values, changed.medium, job.dataset.needle, job.insertions[0]).converged


def test_a_stiffer_needle_in_as_much_stiffer_tissue_bends_alike(job):
    stiff, needle = vary(job, rigidity_factor=1.1).dataset.needle, job.dataset.needle
    hollow = vary(job, inner_diameter_mm=1.27 / 2).dataset.needle
    assert hollow.flexural_rigidity == pytest.approx(15 / 16 * needle.flexural_rigidity)
    values = dict(job.hand_tuned)
    more = {name: 1.1 * value if name.startswith("mu") else value for name, value in values.items()}
    soft, hard = (
        predict(given, job.medium, tube, job.insertions[-1]).u
        for given, tube in ((values, needle), (more, stiff))
    )
    np.testing.assert_allclose(hard, soft, atol=1e-7)


def test_a_variation_that_changes_nothing_is_refused(tmp_path):
    file = tmp_path / "nothing.toml"
    file.write_text(
        'schema = 1\nkind = "sensitivity"\nstudies = ["small"]\n[[variations]]\nfactor = "x"\nname = "y"\n'
    )
    with pytest.raises(ConfigError, match="changes nothing"):
        load_study(file)


def test_a_small_study_under_variations(world, tmp_path):
    answer = world.restore("sensitivity")
    studies = answer.frames["studies"].set_index(["aspect", "tuned", "metric"])["change"].sort_index()
    assert abs(studies.loc["rigidity", "again", "te_mm"]) < 1e-2
    assert abs(studies.loc["rigidity", "kept", "te_mm"]) > 1e-2
    assert ("constraint spacing", "kept") not in studies.index  # b is per spacing
    ratios = answer.frames["parameter_changes"].set_index(["aspect", "parameter"])["ratio"]
    assert ratios["rigidity", "mu1_pa"] == pytest.approx(1.1, rel=0.01)
    assert pd.isna(ratios["constraint spacing", "bevel_mm"])
    assert "2 variations" in REPORT.summarize(answer)[0]
    assert REPORT.draw(answer, tmp_path)[0]["studies"].is_file()
    again, kept, *_ = REPORT.lay_out(answer)
    assert len(again.rows) == 3 and len(kept.rows) == 2
    assert answer.run["variations"]["constraint spacing: 2 mm"]["constraint_spacing_mm"] == 2.0
    # where no variation keeps the parameters
    studies = answer.frames["studies"]
    spaced = answer.with_frames(studies=studies[studies["aspect"] != "rigidity"])
    assert "No variation keeps the parameters." in REPORT.summarize(spaced)


def errors(**columns: list) -> pd.DataFrame:
    """Return error rows, what is not given filled in."""
    count = len(next(iter(columns.values())))
    rest = {"study": "study3", "role": "validate", "medium": "phantom1", "specimen": "a", "layers": 3}
    rest |= dict.fromkeys([*METRICS.names(), "deflection_mm", "predicted_deflection_mm"], 1.0)
    rest |= {f"floor_{metric.name}": 0.1 for metric in list_metrics() if metric.has_floor}
    rest |= {"insertion": "i", "method": "fitted", "converged": True, "seed": 1}
    return pd.DataFrame({**{name: [value] * count for name, value in rest.items()}, **columns})


def test_a_twin_that_is_not_scanned_is_nearly_the_one_that_was(tmp_path):
    """Same truth, same places of the markers: what differs is what voxels add."""
    names = ("phantom2-03", "phantom3-05", "chicken-02")
    found = {
        one.id: one for one in read(build_unscanned(tmp_path, 1, select_planned_insertions(names))).insertions
    }
    scanned = {one.id: one for one in read(find_file("dataset", "twin")).insertions}
    for name in names:
        one, other = found[name], scanned[name]
        assert one.sequence == other.sequence and one.side == other.side
        assert one.depth == pytest.approx(other.depth, abs=0.2)
        assert one.deflection == pytest.approx(other.deflection, abs=0.3)
        np.testing.assert_allclose(one.boundaries, other.boundaries, atol=0.05)
        assert one.pose_shift_sd == pytest.approx(other.pose_shift_sd, rel=0.01)
    assert "not scanned" in read(tmp_path).notes[0]


def test_an_interval_over_twins_is_that_of_their_means():
    """Insertions of one twin err alike: however many there are, 20 twins are 20 numbers."""
    rng = np.random.default_rng(2)
    twins = rng.normal(size=20)
    values = np.repeat(twins[:, None], 50, axis=1)
    low, high = bootstrap_interval(values, 4000, np.random.default_rng(3))
    width = 2 * 1.96 * twins.std() / np.sqrt(20)
    assert high - low == pytest.approx(width, rel=0.05)
    assert low < twins.mean() < high


def test_a_comparison_is_won_where_the_interval_excludes_zero():
    seeds = np.repeat(np.arange(8), 3)
    pairs = [{"seed": int(s), "insertion": f"i{k % 3}"} for k, s in enumerate(seeds)]
    noise = np.random.default_rng(1).normal(size=24)
    parts = []
    for method, te in (
        ("fitted", 0.5 + 0.0 * noise),
        ("straight", 1.0 + 0.1 * noise),
        ("truth", 0.5 + noise),
    ):
        parts.append(errors(**pd.DataFrame(pairs).to_dict("list"), te_mm=te.tolist(), method=[method] * 24))
    found = compare_methods(pd.concat(parts), "x", 500).query("metric == 'te_mm'").set_index("method")
    assert found["verdict"].to_dict() == {"straight": "wins", "truth": "open"}
    assert found.loc["straight", "difference"] == pytest.approx(-0.5 - 0.1 * noise.mean())
    assert found.loc["straight", ["replicates", "insertions", "replicates_better"]].tolist() == [8, 3, 8]


def test_a_loss_is_explained_only_where_the_data_support_it():
    """A method that bends less everywhere is excused on a medium that bends less, and nowhere else."""
    rows = [
        ("tune", "phantom2", "fitted", 0.1, 3.0),
        ("tune", "phantom2", "straight", 3.0, 0.0),
        ("validate", "phantom1", "fitted", 2.0, 3.0),
        ("validate", "phantom1", "straight", 1.0, 0.0),
    ]
    columns = dict(
        zip(
            ("role", "medium", "method", "te_mm", "predicted_deflection_mm"),
            zip(*rows, strict=True),
            strict=True,
        )
    )
    frame = errors(**{name: list(values) for name, values in columns.items()})
    lost = {"study": "study3", "medium": "phantom1", "layers": 3, "method": "straight", "metric": "te_mm"}
    comparison = pd.DataFrame([{**lost, "verdict": "loses", "difference": 1.0, "floor": 0.1}])
    none = pd.DataFrame(
        {"study": [], "parameter": pd.Series([], dtype=str), "value": [], "truth": [], "paper": []}
    )
    (why,) = explain_losses(comparison, frame, none)["note"]
    assert re.search(r"\b1\.00 mm\b.*\b3\.00\b.*\b0\.00\b", why)  # measured, the fit, the method
    frame.loc[1, "te_mm"] = 0.05  # now the method errs less on what was tuned on as well
    assert explain_losses(comparison, frame, none)["note"].tolist() == [UNEXPLAINED]
    assert explain_losses(comparison.assign(verdict="wins"), frame, none)["note"].tolist() == [""]


def test_the_threshold_lies_in_the_gap_of_the_papers_table():
    assert generalisation_threshold() == pytest.approx((0.46 * 1.18) ** 0.5)
    found = tabulate_generalisation(errors(study=["a", "b"], ipe_mean_mm=[0.7, 0.8]), ())
    assert found["generalises"].tolist() == [True, False]


def test_every_cell_is_next_to_the_papers_value():
    held_out = errors(insertion=["a", "b", "c"], te_mm=[1.0, 2.0, np.inf], converged=[True, True, False])
    fits = errors(study=["phantom2"] * 2, role=["tune"] * 2, medium=["phantom2"] * 2, layers=[4, 3])
    found = tabulate_cells(pd.concat([held_out, fits]), {"study3": 3}).set_index(
        ["grouping", "layers", "metric"]
    )
    cell = found.loc[("validation", 3, "te_mm")]
    assert (cell["value"], cell["paper"], cell["insertions"], cell["not_converged"]) == (1.5, 2.82, 3, 1)
    assert found.loc[("tuning_by_layers", 4, "edp_percent"), ["paper", "unit"]].tolist() == [10.3, "percent"]
    assert found.loc[("tuning_by_media", 0, "te_mm"), "paper"] == 0.37


def test_the_studies_on_two_twins_are_reported(world, tmp_path):
    answer = world.restore("seeds")
    table = answer.frames["errors"]
    truth = table[(table["method"] == "truth") & (table["role"] == "validate")]
    assert truth["te_mm"].max() < 0.5 and truth["seed"].nunique() == 2  # registration alone
    assert answer.run["seeds"] == [1, 2] and answer.run["twins"] == "not scanned"
    page = find_kind("seeds").report
    assert "2 of 2 " in page.summarize(answer)[0]
    assert {"generalising.pdf", "comparisons.pdf", "cells.pdf"} == {
        p.name for p in page.draw(answer, tmp_path)[0].values()
    }
    lost = {table.name: table for table in page.lay_out(answer)}["losses"]
    assert len(lost.rows) == (answer.frames["comparisons"]["verdict"] == "loses").sum()


def _even(values, again):
    """Curves (O, N) as if they were of one needle."""
    return again.means(np.asarray(values)[:, :, None])


@pytest.mark.parametrize(("limit", "value"), [(2.5, 3), (3.0, 1), (5.0, 0), (0.5, np.inf)])
def test_a_count_is_the_first_from_which_on_the_mean_stays_within_the_limit(limit, value):
    # the mean is 5, 1, 3, 1: one insertion is enough for a moment, three are for good
    means = _even(
        [[6.0, 1.0, 4.0, 1.0], [4.0, 1.0, 2.0, 1.0]], Resampling.draw(2, 1, np.random.default_rng(1))
    )
    found = estimate_needed_count(means, (0, 1, 2, 3), np.full(len(means), limit))
    assert found.value == value
    assert np.isfinite(value) or (found.low, found.high) == (np.inf, np.inf)


def test_the_interval_of_a_count_is_what_other_orders_would_have_given():
    # with the first order alone one insertion is enough, with the second alone two
    means = _even([[9.0, 1.0, 1.0], [9.0, 5.0, 1.0]], Resampling.draw(2, 1, np.random.default_rng(1)))
    found = estimate_needed_count(means, (0, 1, 2), np.full(len(means), 2.0))
    assert (found.value, found.low, found.high) == (2, 1, 2)


def test_an_interval_is_of_needles_even_where_all_orders_agree_and_a_gain_is_paired_order_by_order():
    # two needles gain 0 and 1, whatever the order: their mean is 0.5, drawn again 0, 0.5 or 1
    again = Resampling.draw(3, 2, np.random.default_rng(1))
    found = estimate(again.means(np.tile([0.0, 1.0], (3, 1, 1)))[:, 0])
    assert (found.value, found.low, found.high) == (0.5, 0.0, 1.0)
    # orders differ by far more than the ways do, which leaves the difference sure
    again, methods = Resampling.draw(3, 1, np.random.default_rng(1)), np.array([[1.0], [10.0], [100.0]])
    found = estimate((_even(methods, again) - _even(methods - 0.5, again))[:, 0])
    assert (found.value, found.low, found.high) == pytest.approx((0.5, 0.5, 0.5))


def test_orders_differ_and_end_with_all_there_are():
    names = ("a", "b", "c", "d")
    drawn = draw_orders(names, 6, np.random.default_rng(3))
    assert len(set(drawn)) == 6 and all(sorted(order) == sorted(names) for order in drawn)
    assert len({tuple(sorted(order[:2])) for order in drawn}) > 3  # no rotations of one another
    assert len(set(draw_orders(("a", "b", "c"), 99, np.random.default_rng(3)))) == 6


def test_an_inflated_prior_is_the_old_posterior_widened_by_twice_the_spreads_square():
    old = Parameters.from_record(medium(layers=1))
    rng = np.random.default_rng(5)
    covariance = np.array([[0.4, -0.1], [-0.1, 0.05]])
    centre = old.theta({"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08})
    thetas = centre + rng.multivariate_normal([0.0, 0.0], covariance, size=20000)
    fit = old.values(centre)
    same = widen_posterior(old, fit, thetas, old, {})
    wider = widen_posterior(old, fit, thetas, old, {"mu1_pa": 0.6, "bevel_mm": 0.2})
    assert [same.marginals[name][0] for name in old.free] == pytest.approx(centre)
    found, more = (np.linalg.inv(prior.information(old.free)) for prior in (same, wider))
    assert found == pytest.approx(covariance, abs=0.02)
    assert more - found == pytest.approx(np.diag([2 * 0.6**2, 2 * 0.2**2]), abs=1e-9)


def test_layers_that_the_old_medium_ties_may_differ_in_the_new_one():
    old = Parameters.from_record(medium(layers=2, mu2_pa={"tie": "2 * mu1_pa"}))
    new = Parameters.from_record(medium(layers=2))
    fit = old.values(old.theta({"mu1_pa": 1e5, "bevel_mm": 0.1}))
    thetas = np.array([old.theta(fit), old.theta({**fit, "mu1_pa": 1.2e5})])
    prior = widen_posterior(old, fit, thetas, new, {"mu1_pa": 0.5, "mu2_pa": 0.5})
    assert {name: np.exp(mean) for name, (mean, _) in prior.marginals.items()} == pytest.approx(
        {"mu1_pa": 1e5, "mu2_pa": 2e5, "bevel_mm": 0.1}
    )
    cov = np.linalg.inv(prior.information(new.free))
    together = np.log(1.2) ** 2 / 2
    assert cov[0, 1] == pytest.approx(together + 0.5 * 2 * 0.5**2)  # half of the variance is a common factor
    assert cov[1, 1] == pytest.approx(together + 2 * 0.5**2 + MIN_SPREAD**2)


def test_the_mixture_has_both_parts_of_an_old_posterior():
    """A peak, and a plateau 6 away with a tenth of the draws: their Gaussian is far too wide at the peak."""
    parameters = Parameters.from_record(medium(layers=1))
    rng = np.random.default_rng(5)
    centre = parameters.theta({"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08})
    thetas = centre + 0.1 * rng.standard_normal((1000, 2))
    thetas[:100, 0] += 6.0
    spread = {"mu1_pa": 0.3, "bevel_mm": 0.2}
    fit = parameters.values(centre)
    transferred = TransferredPrior.from_draws(parameters, fit, thetas, parameters, spread)
    prior = transferred.parameters.prior
    drawn = transferred.draw(4000, rng)
    assert np.mean(drawn[:, 0] > centre[0] + 3) == pytest.approx(0.1, abs=0.02)
    near = drawn[drawn[:, 0] < centre[0] + 3]
    assert np.std(near, axis=0) == pytest.approx(np.hypot(0.1, np.sqrt(2) * np.array([0.3, 0.2])), rel=0.05)
    # the mixture's density beside that of the two Gaussians from which all this was drawn, of any correlation
    rhos = np.linspace(-1, 1, 401)[1::2]
    cross = 2 * 0.3 * 0.2 * np.array([[0.0, 1.0], [1.0, 0.0]])
    between = [0.01 * np.eye(2) + 2 * np.diag([0.3**2, 0.2**2]) + rho * cross for rho in rhos]

    def density(away: np.ndarray) -> float:
        return float(np.mean([multivariate_normal.pdf(away, [0.0, 0.0], one) for one in between]))

    at = centre + np.array([[0.0, 0.0], [0.8, 0.3], [6.0, 0.0]])
    expected = [
        np.log(sum(w * density(one - centre - off) for w, off in ((0.9, [0, 0]), (0.1, [6, 0]))))
        for one in at
    ]
    found = transferred.correct(at) + [prior.log_density(parameters.values(one)) for one in at]
    assert found - found[0] == pytest.approx(np.array(expected) - expected[0], abs=0.1)
    problem = TransferProblem.of(_problem(parameters), transferred)
    plain = _problem(transferred.parameters)
    assert problem.log_posteriors(at) - plain.log_posteriors(at) == pytest.approx(transferred.correct(at))
    assert pickle.loads(pickle.dumps(problem)).transferred is not None


def _problem(parameters):
    one = measure(TRUTH, medium(layers=1), insertion(30.0), points=31)
    return Problem(dataset((one,)), (one,), medium(layers=1), parameters, squares_recipe().weights)


def test_the_prior_of_a_bevel_spread_counts_once():
    """Without data: draws of the half-normal prior of the old medium give the new one the same prior."""
    parameters = with_bevel_spread(Parameters.from_record(medium(layers=1)), 0.2)
    spreads = 0.2 * np.abs(np.random.default_rng(6).standard_normal(4000))
    fit = {"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08, "bevel_spread": 0.2}
    thetas = np.tile(parameters.theta(fit), (4000, 1))
    thetas[:, -1] = np.log(np.maximum(spreads, 0.2 * BEVEL_SPREAD_BOUNDS[0]))
    transferred = TransferredPrior.from_draws(parameters, fit, thetas, parameters, {})
    problem = TransferProblem.of(_problem(transferred.parameters), transferred)
    at = np.tile(parameters.theta(fit), (2, 1))
    at[:, -1] = np.log([0.1, 0.4])
    transferred_density, stated_density = (p.log_posteriors(at) for p in (problem, _problem(parameters)))
    # smoothing the draws costs 0.1; the prior counted twice would add half of 2^2 - 0.5^2, less ln 4
    assert np.diff(transferred_density) == pytest.approx(np.diff(stated_density), abs=0.2)
    assert choose_hyperparameters(transferred.parameters)["bevel_spread"] == pytest.approx(0.2)


def test_media_without_a_common_parameter_and_bounds_that_miss_the_old_fit_are_refused():
    old = Parameters.from_record(medium(layers=1))
    fit = old.values(old.theta({"mu1_pa": 3e5, "bevel_mm": 0.08}))
    narrow = Parameters.from_record(medium(layers=1, mu1_pa={"bounds": [1e6, 1e8]}))
    with pytest.raises(ConfigError, match="mu1_pa"):
        widen_posterior(old, fit, old.theta(fit)[None], narrow, {})
    nothing = old.with_only((), fit)
    with pytest.raises(ConfigError, match=r"parameter.* common"):
        widen_posterior(old, fit, old.theta(fit)[None], nothing, {})


TRUTH = {"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08}


def _job(name, insertions, every):
    record = medium(layers=1)
    fit = FitRecord.model_validate({"schema": 1, "dataset": "cases", "medium": "test"})
    recipe = squares_recipe(starts=2)
    parameters = Parameters.from_record(record)
    return Job(name, fit, dataset(every), record, parameters, recipe, None, (Fold("all", insertions, ()),))


@pytest.fixture(scope="module")
def not_new():
    """The old posterior in the same medium, without spread between media; needles without errors."""
    planned = [insertion(30.0 + 6 * k, side=(1, -1)[k % 2]) for k in range(4)]
    made = tuple(measure(TRUTH, medium(layers=1), one, points=31) for one in planned)
    sides = {"medium": "test", "insertions": {}}
    table = {"schema": 1, "kind": "adaptation", "dataset": "cases", "old": sides}
    table |= {"new": {**sides, "held_out": ("x",)}, "counts": (0, 1)}
    table["between_media"] = {"ln_mu_sd": 0, "ln_bevel_sd": 0, "source": "none"}
    record = AdaptationRecord.model_validate(table)
    old, new = _job("old", made[:2], made), _job("new", made[2:], made)
    training = {one.id: one for one in made[2:3]}
    task = AdaptationTask(record, Settings(), old, new, made[3:], training, (tuple(training),))
    return run_analysis("same", record, Settings(), plan(task))


def test_a_medium_that_is_not_new_costs_nothing(not_new):
    table = not_new.frames["insertions_needed"]
    counts = table[table["target"] == "floor"].set_index(["method", "metric"])["n"]
    assert [counts[one, "te_mm"] for one in ("none", "inflated", "new")] == [0, 0, 1]
    curves = not_new.frames["adaptation"].set_index(["method", "n"])
    errors, scores = curves["te_mm"], curves["tip_crps_mm"]
    assert errors["none", 0] < 1e-3
    assert errors["inflated", 0] == pytest.approx(errors["none", 0], abs=1e-6)
    assert scores["inflated", 0] == pytest.approx(scores["none", 0], rel=1e-6)  # the old posterior itself
    assert not_new.faults == ()
    # held-out insertions are never fitted
    assert set(not_new.frames["errors"]["insertion"]) == {"at48"}
    assert set(not_new.frames["fits"]["learned_from"]) == {"nothing", "at42"}


def test_differences_are_summed_over_groups_and_their_error_is_that_of_the_groups():
    differences = pd.Series([0.5, 0.5, 2.0, 3.0])
    total, error, count = sum_differences(differences, pd.Series(["a", "a", "b", "c"]))
    assert (total, error, count) == pytest.approx((6.0, math.sqrt(3.0), 3))  # sums 1, 2, 3: sd 1
    assert [verdict(d, 1.0) for d in (6.0, 1.9, -1.9, -2.1)] == ["ahead", "tie", "tie", "behind"]
    assert verdict(-np.inf, np.nan) == "tie"  # nothing is known where a density is missing


def test_posterior_uncertainty_adds_up_over_needles_that_share_it():
    errors = {"log_density_se": [0.5, 0.5, 0.4], "shared_se": [0.3, 0.3, 0.0], "fold": ["1", "1", "2"]}
    # 0.4^2 + 0.4^2 + 0.4^2 of the needles, (2 * 0.3)^2 of the first fold
    assert monte_carlo_error(pd.DataFrame(errors)) == pytest.approx(math.sqrt(3 * 0.16 + 0.36))


def test_repeats_are_never_on_both_sides_and_there_are_no_more_folds_than_needles():
    many = tuple(replace(insertion(30.0 + k), specimen=f"hole {k % 5}") for k in range(15))
    for fold in deal_folds(many, [one.specimen for one in many], 3):
        assert not {one.specimen for one in fold.tune} & {one.specimen for one in fold.validate}
        assert len(fold.tune) + len(fold.validate) == 15
    block = tuple(replace(insertion(30.0 + k), specimen="one block") for k in range(4))
    assert [len(fold.validate) for fold in deal_folds(block, list("abcd"), 4)] == [1, 1, 1, 1]
    with pytest.raises(ConfigError, match=r"5 folds .*4 groups"):
        deal_folds(block, list("abcd"), 5)


def _curved(depth, side=1):
    """A needle of curvature 0.001 / mm toward its bevel, with a bump that no curve of the family has."""
    s = np.linspace(0.0, depth, 31)
    planar = np.column_stack([s, side * 0.0005 * s**2 + 0.02 * np.sin(s / 4)])
    flat = np.zeros(len(s))
    return replace(insertion(depth, side=side), planar=planar, out_of_plane=flat)


def _curves(count=3):
    return tuple(_curved(30.0 + 5 * k, (1, -1)[k % 2]) for k in range(count))


def _log_density(off, one, scale, slope, s):
    """Return the Gaussian log density of deflections: errors of points, pose and registration."""
    x = one.planar[:, 0] - one.planar[0, 0]
    shift = NOISE.registration_mean / math.sqrt(8 / math.pi)
    modes = np.column_stack([shift * np.ones(len(x)), one.pose_angle_sd * x, -shift * slope])
    cov = scale**2 * points_covariance(s, NOISE) + modes @ modes.T
    return multivariate_normal.logpdf(off, cov=cov)


def _slope(one, degree):
    x = one.planar[:, 0] - one.planar[0, 0]
    return np.polynomial.Polynomial.fit(x, one.planar[:, 1], degree).deriv()(x)


def test_a_curves_density_is_the_gaussian_of_its_deflections():
    one = _curved(40.0)
    density = CurveDensity("constant_curvature", dataset([one]), (one,), LikelihoodRecord(), 1000.0)
    theta = np.array([0.0012 * COEFFICIENT_LENGTH_MM, math.log(1.7)])
    s = density.observations[0].nodes.s[0]
    off = density.curve(theta).curve(one)(s)[:, 1] - one.planar[:, 1]
    assert density(theta[None])[0] == pytest.approx(_log_density(off, one, 1.7, _slope(one, 3), s), rel=1e-6)
    assert density(np.array([[0.0, math.log(1e4)]]))[0] == -np.inf


def test_a_curves_peak_is_where_its_density_is_greatest():
    made = _curves()
    density = CurveDensity("constant_curvature", dataset(made), made, LikelihoodRecord(), 1000.0)
    peak = density.peak
    around = peak + 0.02 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    assert density(peak[None])[0] > density(around).max()
    assert density.curve(peak).coefficients[0] == pytest.approx(0.001, rel=0.2)


def test_a_straight_lines_density_is_that_of_the_noise_factor_alone():
    """Its one parameter can be integrated over by quadrature."""
    made = _curves()
    fold = Fold("all but one", made[:2], made[2:])
    found = fit_candidate(
        "straight", candidate_job("straight", comparison_job(made, (fold,))), fold, Settings()
    )

    def log_evidence(insertions):
        density = CurveDensity("straight", dataset(made), insertions, LikelihoodRecord(), MAX_NOISE_FACTOR)
        top = density(density.peak[None])[0]
        scaled = quad(lambda at: np.exp(density(np.array([[at]]))[0] - top), *(density.peak[0] + [-2.0, 2.0]))
        return top + math.log(scaled[0])

    density = found.predict_density(made[2])
    assert density.log_density == pytest.approx(log_evidence(made) - log_evidence(made[:2]), abs=0.15)
    assert density.k < 0.7 and density.se < 0.1


def test_further_points_add_their_whole_density():
    """Nothing that the likelihood drops is missing from the ratio of two posteriors."""
    made = [measure(TRUTH, medium(layers=1), insertion(30.0 + 6 * k), points=31) for k in range(2)]
    job = candidate_job("ogden", comparison_job(tuple(made), ()))
    # all bevels are the same: a further one would change what b is the mean of
    theta = job.parameters.theta({**TRUTH, "bevel_mm": 0.1, NOISE_SCALE: 1.3, BEVEL_SPREAD: 1e-3})
    one, both = (job.problem(Fold("", tuple(some), ())) for some in (made[:1], made))
    s = both.density.observations[1].nodes.s[0]
    shape = predict(both.values(theta), medium(layers=1), NEEDLE, made[1])
    off = compute_positions(shape, s)[:, 1] - made[1].planar[:, 1]
    exact = _log_density(off, made[1], 1.3, _slope(made[1], 5), s)
    assert both.log_posterior(theta) - one.log_posterior(theta) == pytest.approx(exact, abs=0.02)


RECORD = {"schema": 1, "kind": "comparison", "dataset": "cases", "medium": "test", "folds": 2}


def comparison_job(made, folds):
    fit = FitRecord.model_validate({"schema": 1, "dataset": "cases", "medium": "test"})
    parameters = Parameters.from_record(medium(layers=1))
    recipe = squares_recipe(starts=2)
    return Job("cases", fit, dataset(made), medium(layers=1), parameters, recipe, None, folds)


@pytest.fixture(scope="module")
def compared():
    candidates = ("ogden", "linear", "straight")
    record = ComparisonRecord.model_validate({**RECORD, "candidates": candidates, "positive_control": True})
    rng, made = np.random.default_rng(3), []
    for k in range(4):
        planned = measure(TRUTH, medium(layers=1), insertion(34.0 + 6 * k, side=(1, -1)[k % 2]), points=21)
        made.append(simulate_measurement(dataset([planned]), planned, TRUTH, medium(layers=1), rng))
    job = comparison_job(tuple(made), deal_folds(tuple(made), list("abcd"), 2))
    return run_analysis("cases", record, Settings(), plan_comparison(record, job, Settings()))


@pytest.mark.sweep
def test_laws_tie_where_strains_are_small_and_a_straight_line_loses(compared):
    scores, table = compared.frames["scores"], compared.frames["comparison"].set_index("method")
    assert table["verdict"].to_dict() == {"ogden": "reference", "linear": "tie", "straight": "behind"}
    assert abs(table.loc["linear", "difference"]) < 3.0 and table.loc["straight", "difference"] < -20.0
    assert 0.5 < table.loc["ogden", "noise_scale"] < 2.0
    # the error of draws is small, and part of the verdict
    assert scores["log_density_se"].max() < 0.2 and scores["pareto_k"].max() < 0.7
    own = compared.frames["differences"].query("method == 'linear'")
    scatter, drawn = sum_differences(own["difference"], own["group"])[1], table["draws_se"]
    error = math.hypot(scatter, drawn["linear"], drawn["ogden"])
    assert table["difference_se"][["linear", "ogden"]].tolist() == pytest.approx([error, 0.0])
    # a control that the comparison misses is a fault
    (fault,) = compared.faults
    assert "ahead of linear" in fault and "straight" not in fault
    assert "over 4 needles" in COMPARISON_REPORT.summarize(compared)[1]
    grouped = compared.with_frames(differences=compared.frames["differences"].assign(group="one hole"))
    assert "repeats" in COMPARISON_REPORT.summarize(grouped)[1]


@pytest.mark.parametrize(
    ("changed", "fault"),
    [({"dataset": None}, "neither dataset nor"), ({"candidates": ("linear", "straight")}, "candidates")],
)
def test_a_study_names_its_data_or_makes_them(changed, fault):
    with pytest.raises(ValueError, match=fault):
        ComparisonRecord.model_validate({**RECORD, **changed})


MOVED = replace(insertion(40.0), base_moved=8.0)
THIN = medium(layers=1).model_copy(update={"thickness_mm": 5.0})
SOFT = {"mu1_pa": 3e3, "alpha1": 1.0, "bevel_mm": 0.03}


def test_a_base_that_moves_does_so_once_the_needle_is_in():
    bevel = Bevel(0.03)
    tissue = Tissue(np.array([3e-3]), np.array([1.0]), np.empty(0), np.array([5.0]))
    steps = (Step(40.0, bevel), Step(40.0, bevel, Controls(base_y=8.0)))
    shape = predict(SOFT, THIN, NEEDLE, MOVED)
    assert shape.u == pytest.approx(
        simulate_steps(NEEDLE, tissue, steps, ModelOptions(tolerance=1e-9)).u, abs=1e-9
    )
    still = predict(SOFT, THIN, NEEDLE, replace(MOVED, base_moved=0.0))
    assert shape.constraints == pytest.approx(still.constraints, abs=1e-9)  # the cut stays where it was
    assert compute_positions(shape, np.array([0.0]))[0, 1] > 1.0  # the tissue gives way at the entry
    (lanes,) = simulate_batches([make_batch([SOFT], THIN, NEEDLE, MOVED)])
    assert lanes.u[0] == pytest.approx(shape.u, abs=1e-6)


def test_a_moved_bases_needle_has_exact_derivatives():
    parameters = Parameters.from_record(THIN)
    theta, s = parameters.theta(SOFT), np.linspace(0.0, 40.0, 9)
    _, ((slopes,),) = PreparedModel(THIN, NEEDLE, [MOVED]).differentiate([SOFT], parameters, [s])
    for k, move in enumerate(1e-4 * np.eye(len(theta))):
        ends = [predict(parameters.values(theta + sign * move), THIN, NEEDLE, MOVED) for sign in (1, -1)]
        by = (compute_positions(ends[0], s) - compute_positions(ends[1], s)) / 2e-4
        assert slopes[:, :, k] == pytest.approx(by, rel=1e-3, abs=1e-6)
