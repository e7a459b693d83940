"""The judge: checks and verdicts of one fit, and of several by paired differences."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from reporting_results import stereo, study, with_predictions

from needlefit.project.result_warnings import ResultWarning, to_stored_rows
from needlefit.studies.answer import Check, Verdict, worst_status
from needlefit.studies.fit_tables import lay_out_matrix, lay_out_summary
from needlefit.studies.judge import (
    compare_with_curves,
    describe_fit,
    join_trials,
    judge,
    judge_fits,
    judge_tracks,
    list_checks,
)
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import pool_insertions


@pytest.mark.parametrize(
    ("error", "ratio", "curve", "outcome"),
    [
        (0.2, 2.0, 0.3, "predicts"),
        (0.2, 2.1, 0.3, "in part"),
        (0.2, 5.0, 0.3, "in part"),
        (0.2, 5.1, 0.3, "does not predict"),
        (0.2, 0.5, 0.1, "does not predict"),
        (0.2, None, 0.3, "in part"),  # no noise is stated
        (0.2, 1.0, None, "predicts"),  # no curve was scored
    ],
)
def test_one_fit_is_described_by_noise_and_closest_curve(error, ratio, curve, outcome):
    assert describe_fit(error, ratio, curve) == outcome


def with_tip_errors(results: Run, **mm: tuple[float, float]) -> Run:
    """Replace the tip errors of methods by mean and alternating deviation; the floor is 0.22 mm."""
    errors = results.frames["errors"].copy()
    for method, (mean, deviation) in mm.items():
        rows = errors["method"] == method
        number = pd.factorize(errors.loc[rows, "insertion"])[0]
        errors.loc[rows, "te_mm"] = mean + deviation * np.where(number % 2, 1, -1)
    return results.with_frames(errors=errors)


CURVES = dict.fromkeys(("straight", "constant_curvature", "linear_curvature"), (9.0, 0.0))


@pytest.mark.parametrize(
    ("fitted", "straight", "status"),
    [((0.1, 0.0), (0.2, 0.0), "pass"), ((1.0, 0.01), (2.0, 0.01), "warn"), ((2.0, 0.0), (1.0, 0.0), "fail")],
)
def test_the_verdict_states_what_it_is_made_of(fitted, straight, status):
    results = with_tip_errors(study(4), **{**CURVES, "fitted": fitted, "straight": straight})
    (verdict,) = results.verdicts
    assert verdict.status == status
    assert verdict.numbers["te_mm"] == pytest.approx(fitted[0], abs=fitted[1] / 8)
    assert verdict.numbers["te_over_floor"] == pytest.approx(verdict.numbers["te_mm"] / 0.22)
    assert verdict.numbers["baseline"] == "straight" and verdict.numbers["paper_te_mm"] == 2.19
    assert verdict.numbers["baseline_te_mm"] == pytest.approx(straight[0], abs=straight[1] / 8)


def test_the_predictive_median_is_judged_where_there_is_one():
    results = with_tip_errors(study(4), **{**CURVES, "fitted": (0.1, 0.0)})
    errors = results.frames["errors"]
    held = errors[(errors["method"] == "fitted") & (errors["boundaries"] == "measured")]
    median = held[held["role"] == "validate"].assign(method="predictive_median", te_mm=0.7)
    both = results.with_frames(errors=pd.concat([errors, median]))
    assert both.verdicts[0].numbers["te_mm"] == pytest.approx(0.7)
    assert [one.status for one in (results.verdicts[0], both.verdicts[0])] == ["pass", "warn"]


def test_what_is_not_complete_passes_nowhere():
    good = with_tip_errors(study(4), **{**CURVES, "fitted": (0.1, 0.0)})
    assert good.verdicts[0].status == "pass"
    assert replace(good, interrupted=True).verdicts[0].status == "warn"
    assert worst_status([Verdict(""), Verdict("", "fail"), Verdict("", "warn")]) == "fail"


def find(results: Run, check: Check):
    return next(one for one in list_checks(results) if one.check is check)


@pytest.mark.parametrize(
    ("levels", "passed"),
    [
        ((0.1, 0.4, 0.7, 0.97), {"coverage_95": True, "coverage_50": True}),
        ((0.9999,), {"coverage_95": False, "coverage_50": False}),
        ((0.5,), {"coverage_95": True, "coverage_50": False}),  # too many in the 50 % intervals
    ],
)
def test_coverage_is_checked_against_its_shares(levels, passed):
    results = with_predictions(study(1), levels)
    found = {one.check: one for one in list_checks(results)}
    assert {str(key): found[key].passed for key in (Check.COVERAGE_95, Check.COVERAGE_50)} == passed
    assert found[Check.COVERAGE_95].trials == 7 and found[Check.COVERAGE_95].threshold == 6
    assert found[Check.WIDTH].value == pytest.approx(0.6) and found[Check.WIDTH].passed


def test_few_tips_do_not_decide_the_50_percent_intervals():
    assert find(with_predictions(stereo()), Check.COVERAGE_50).passed is None


def test_the_width_that_serves_for_aiming_is_a_key_of_the_recipe():
    results = with_predictions(study(1))
    recipe = results.metadata.recipe.model_copy(update={"aiming_width_mm": 0.5})
    narrow = results.with_metadata(recipe=recipe)
    assert [find(one, Check.WIDTH).passed for one in (results, narrow)] == [True, False]


def test_warnings_about_the_data_are_one_check():
    results = study(4)
    assert find(results, Check.DATA).passed
    kinds = ("noise_too_large", "validity", "copy")
    warned = to_stored_rows(ResultWarning(kind, "") for kind in kinds)
    found = find(results.with_metadata(warnings=warned), Check.DATA)
    assert (found.passed, found.named) == (False, "noise_too_large, copy")


def pairs(gaps: np.ndarray, fold=None, specimen=None, hole=None) -> pd.DataFrame:
    """Return errors of two methods whose tip errors differ by `gaps`, an insertion each."""
    names = [f"i{n}" for n in range(len(gaps))]
    about = {"insertion": names}
    about |= {"fold": fold or names, "specimen": specimen or names, "hole": hole or names}
    ours = pd.DataFrame({**about, "method": "fitted", "te_mm": 1.0 + gaps})
    return pd.concat([ours, pd.DataFrame({**about, "method": "straight", "te_mm": 1.0})])


def test_paired_differences_have_students_p_values():
    gaps = np.array([-0.3, -0.1, -0.25, 0.05, -0.2])
    (found,) = compare_with_curves(pairs(gaps), "fitted").to_dict("records")
    assert (found["score"], found["curve"], found["trials"]) == ("te_mm", "straight", 5)
    assert found["difference_mm"] == pytest.approx(gaps.mean())
    for side, alternative in (("p_smaller", "less"), ("p_larger", "greater")):
        exact = scipy.stats.ttest_1samp(gaps, 0, alternative=alternative).pvalue
        assert found[side] == pytest.approx(exact)


@pytest.mark.parametrize(
    ("te", "crps", "outcome"),
    [
        (-0.3, -0.3, "generalises"),
        (-0.3, 0.0, "not shown"),
        (0.0, -0.3, "not shown"),
        (0.0, 0.3, "does not generalise"),
        (-0.3, 0.3, "does not generalise"),
        (0.3, -0.3, "does not generalise"),
    ],
)
def test_both_scores_decide_whether_fits_generalise(te, crps, outcome):
    """A curve predicts a point: its CRPS is its tip error, 1 mm here."""
    about = np.array([-0.02, 0.01, 0.03, -0.03, 0.01])
    errors = pairs(te + about)
    errors["tip_crps_mm"] = np.where(errors["method"] == "fitted", errors["te_mm"] - te + crps, np.nan)
    assert judge_fits(errors, "fitted") == outcome


def test_what_shares_a_fit_a_specimen_or_a_hole_is_one_trial():
    rows = pd.DataFrame({"fold": list("aabcd"), "specimen": list("ppqqr"), "hole": list("12345")})
    assert len(set(join_trials(rows))) == 3
    chained = pd.DataFrame({"fold": list("aab"), "specimen": list("pqq"), "hole": list("123")})
    assert len(set(join_trials(chained))) == 1
    gaps = np.array([-0.3, -0.1, -0.25, 0.05])
    one_fit = pairs(gaps, fold=["all"] * 4)
    assert compare_with_curves(one_fit, "fitted").empty and judge_fits(one_fit, "fitted") == "not shown"
    (two,) = compare_with_curves(pairs(gaps, specimen=list("ppqq")), "fitted").to_dict("records")
    means = np.array([gaps[:2].mean(), gaps[2:].mean()])
    assert two["trials"] == 2 and two["p_smaller"] == pytest.approx(
        scipy.stats.ttest_1samp(means, 0, alternative="less").pvalue
    )


def test_several_fits_generalise_only_where_they_beat_every_curve():
    results = stereo()
    near = {"fitted": (0.1, 0.01), "straight": (2.0, 0.01)}
    others = {"constant_curvature": (1.0, 0.02), "linear_curvature": (1.5, 0.02)}
    outcomes = []
    for changed in ({}, {"constant_curvature": (0.1, 0.0)}, {"straight": (0.01, 0.0), "fitted": (2.0, 0.01)}):
        one = with_tip_errors(results, **{**near, **others, **changed})
        group = pool_insertions(one)
        outcomes.append((judge(one, group).outcome, find(one, Check.CURVES).passed))
    assert outcomes == [("generalises", True), ("not shown", None), ("does not generalise", False)]


def test_the_crps_of_predicted_tips_is_judged_too():
    results = with_predictions(with_tip_errors(stereo(), **{**CURVES, "fitted": (0.1, 0.01)}))
    errors, predictive = results.frames["errors"], results.frames["predictive"]
    median = errors.query("method == 'fitted' and role == 'validate'").assign(method="predictive_median")
    outcomes = []
    for crps in (0.1, 10.0):
        frames = {"errors": pd.concat([errors, median]), "predictive": predictive.assign(tip_crps_mm=crps)}
        outcomes.append(results.with_frames(**frames).verdicts[0].numbers["outcome"])
    assert outcomes == ["generalises", "does not generalise"]


def test_tracks_of_several_fits_are_judged_and_those_of_one_described():
    about = {"run": list("abcd"), "specimen": list("pqrs"), "direction": "y"}
    ours = pd.DataFrame({**about, "method": "fitted", "rms_mm": [0.5, 0.6, 0.5, 0.4], "crps_mm": 0.3})
    line = pd.DataFrame({**about, "method": "straight", "rms_mm": 1.0, "crps_mm": 0.8})
    runs = pd.concat([ours, line])
    assert judge_tracks(runs.assign(fold=[*"1234"] * 2), 0.5, 1.0) == "generalises"
    assert judge_tracks(runs.assign(fold=[*"1234"] * 2, specimen="p"), 0.5, 1.0) == "not shown"
    both = pd.concat([runs.assign(fold=[*"1234"] * 2, direction=axis) for axis in "yz"])  # 4 trials still
    assert judge_tracks(both, 0.5, 1.0) == "generalises"
    assert judge_tracks(runs.assign(fold="all"), 0.5, 1.0) == "in part"
    assert judge_tracks(runs.assign(fold="all"), 0.5, 0.4) == "does not predict"


def test_the_verdict_and_its_numbers_stand_in_the_row_of_all_insertions():
    results = study(1)
    pooled = judge(results, pool_insertions(results))
    groups = len(results.frames["errors"].query("role == 'validate'")[["medium", "layers"]].drop_duplicates())
    assert groups > 1
    matrix, summary = lay_out_matrix([results]), lay_out_summary(results)
    labels = [column.label for column in matrix.columns]
    verdicts = [row[labels.index("Verdict")] for row in matrix.rows]
    assert verdicts == [pooled.outcome] + [""] * groups
    assert summary.rows[0][0] == "all" and f"{pooled.error_mm:.2f}" in summary.rows[0]
    assert len(summary.breaks) == groups
    curve = next(row for row in summary.rows if "closest curve" in " ".join(row))
    assert f"{pooled.curve_mm:.2f}" in curve


def test_a_fit_within_the_noise_shows_its_curves_and_is_not_judged_by_them():
    results = with_tip_errors(study(1), **{**CURVES, "fitted": (0.1, 0.0), "straight": (0.05, 0.0)})
    found = {one.check: one for one in list_checks(results, "tune")}[Check.CURVES]
    assert (found.passed, found.closer, found.threshold) == (None, 1, pytest.approx(0.05))


def test_tips_without_an_interval_are_counted():
    results = with_predictions(study(3))
    kept = results.with_frames(predictive=results.frames["predictive"].iloc[:-2])
    for run, missing in ((results, 0), (kept, 2)):
        found = {one.check: one for one in list_checks(run)}
        assert found[Check.COVERAGE_95].missing == found[Check.COVERAGE_50].missing == missing
