"""Verdicts of runs: status and numbers, from stored tables alone."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from reporting_results import study, with_predictions

from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.studies.kinds.calibration import find_calibration_faults, headline_calibration
from needlefit.studies.kinds.cross_validation.facts import say
from needlefit.studies.report import run_to_json
from needlefit.studies.run import Run
from needlefit.studies.verdict import (
    NOT_CONVERGED,
    VERDICTS_KEY,
    BestBaseline,
    Verdict,
    judge_errors,
    judge_run,
    worst_status,
)


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
    [
        ((0.1, 0.0), (0.2, 0.0), "pass"),
        ((0.1, 0.0), (0.01, 0.0), "warn"),  # a curve is closer, but below the floor that is not significant
        ((0.1, 0.05), (0.11, 0.0), "pass"),  # within the floor, and no curve is closer
        ((0.3, 0.2), (0.29, 0.0), "warn"),
        ((0.3, 0.2), (0.31, 0.0), "warn"),
        ((0.3, 0.01), (2.0, 0.01), "pass"),
        ((1.0, 0.01), (2.0, 0.01), "warn"),  # better than any curve, but far above the floor
        ((1.0, 0.5), (0.99, 0.0), "warn"),  # no significant difference
        ((2.0, 0.01), (1.0, 0.01), "fail"),
    ],
)
def test_status_follows_floor_and_best_baseline(fitted, straight, status):
    results = with_tip_errors(study(4), **{**CURVES, "fitted": fitted, "straight": straight})
    (verdict,) = judge_run(results)
    assert verdict.status == status
    assert verdict.numbers["te_mm"] == pytest.approx(fitted[0], abs=fitted[1] / 8)
    assert verdict.numbers["te_over_floor"] == pytest.approx(verdict.numbers["te_mm"] / 0.22)
    assert (verdict.numbers["baseline"], verdict.numbers["baseline_te_mm"]) == (
        "straight",
        pytest.approx(straight[0], abs=straight[1] / 8),
    )


def test_intervals_that_cover_too_few_insertions_are_no_pass():
    good = with_tip_errors(study(4), **{**CURVES, "fitted": (0.1, 0.0)})
    assert [one.status for one in judge_run(with_predictions(good))] == ["pass"]
    missed = with_predictions(good, levels=(0.9999,))
    assert [one.status for one in judge_run(missed)] == ["warn"]


@pytest.mark.parametrize(
    ("insertions", "baseline", "status"),
    [
        (1, "worse", "warn"),
        (2, "worse", "warn"),
        (3, "worse", "pass"),
        (2, "tie", "warn"),
        (2, "better", "fail"),
    ],
)
def test_one_or_two_insertions_do_not_pass(insertions, baseline, status):
    best = BestBaseline("an arc", {"worse": 9.0, "tie": 0.6, "better": 0.1}[baseline], baseline)
    verdict = judge_errors("gel", 0.5, 1.5, best, insertions)
    assert verdict.status == status and f"n = {insertions}" in verdict.sentence
    assert judge_errors("gel", 0.5, 0.5, None, insertions).status == ("pass" if insertions > 2 else "warn")
    marked = judge_errors("gel", 0.5, 1.5, best, insertions, reliable=False)
    assert marked.status == ("fail" if baseline == "better" else "warn")


def test_a_run_with_faults_claims_nothing():
    results = with_predictions(with_tip_errors(study(4), **{**CURVES, "fitted": (0.1, 0.0)}))
    (good,) = judge_run(results)
    (marked,) = judge_run(replace(results, faults=("the posterior has not converged",)))
    opening = good.sentence.partition(":")[0]
    assert good.status == "pass" and marked.status == "warn"
    assert marked.sentence.startswith("NOT CONVERGED. ") and f" {opening}:" not in marked.sentence


def test_a_preliminary_recipe_is_named():
    results = study(4)
    quick = replace(results, run={**results.run, "recipe": {"preliminary": True}})
    added = [
        one.sentence.removeprefix(old.sentence)
        for one, old in zip(judge_run(quick), judge_run(results), strict=True)
    ]
    assert all("preliminary" in one for one in added)


@pytest.mark.parametrize(("fitted", "status"), [((0.1, 0.0), "warn"), ((0.3, 0.0), "fail")])
def test_a_fit_fails_where_a_curve_is_closer_and_the_errors_are_above_the_floor(fitted, status):
    results = with_tip_errors(study(4), fitted=fitted)
    closer = {**results.run, **warnings_entry([ResultWarning("worse_than_baseline", "")])}
    (verdict, *_) = judge_run(replace(results, kind="fit", run=closer))
    assert verdict.status == status


def test_noise_that_is_too_large_is_no_pass():
    good = with_tip_errors(study(4), **{**CURVES, "fitted": (0.1, 0.0)})
    noisy = {**good.run, **warnings_entry([ResultWarning("noise_too_large", "")])}
    assert [one.status for one in judge_run(replace(good, run=noisy))] == ["warn"]


def test_the_evidence_has_counts_and_coverage():
    results = with_predictions(with_tip_errors(study(4), **CURVES))
    folds = [{"tune": ["a", "b"], "validate": ["c"]}, {"tune": ["a", "b", "c"], "validate": ["d"]}]
    words = say(replace(results, run={**results.run, "folds": folds}), "evidence")
    predicted = results.frames["predictive"]
    tips, count = int(predicted["tip_in_95"].sum()), len(predicted)
    numbers = [int(one) for one in re.findall(r"\d+", words)]
    assert numbers[:4] == [2, 3, 2, 2] and f"{tips} of {count}" in words
    assert re.findall(r"\d+", say(replace(results, run={}), "evidence"))[0] == "95"


def test_one_verdict_for_each_group_and_in_json():
    results = study(1)
    verdicts = judge_run(results)
    assert len({one.group for one in verdicts}) == len(verdicts) == 3 and results.verdicts == verdicts
    rows = run_to_json(results)[VERDICTS_KEY]
    assert [row["status"] for row in rows] == [one.status for one in verdicts]


def test_what_did_not_converge_does_not_pass():
    good = with_tip_errors(study(4), **{**CURVES, "fitted": (0.1, 0.0)})
    assert judge_run(replace(good, faults=("did not converge",)))[0].status == "warn"
    assert judge_run(replace(good, interrupted=True))[0].status == "warn"
    assert worst_status([Verdict(""), Verdict("", "fail"), Verdict("", "warn")]) == "fail"


@pytest.mark.parametrize(
    ("fault", "headline"),
    [
        ("2 of 9 simulations of the fit did not converge", "NOT CONVERGED"),
        ("draws by importance are not certified: Pareto k is 1.20", "NOT CERTIFIED"),
        ("3 held-out insertions could not be predicted", "INCOMPLETE"),
    ],
)
def test_each_kind_of_fault_has_its_headline(fault, headline):
    (verdict,) = judge_run(replace(study(4), faults=(fault, fault)))
    assert verdict.sentence.count(headline) == 1 and verdict.sentence.startswith(headline)


def test_an_outcome_that_the_verdict_names_has_no_headline():
    outcome = {"replicates": 20, "control": None, "not_calibrated": [], "passes": True}
    outcome |= {"conclusive": False, "untrusted": 0}
    (few,) = find_calibration_faults(outcome)
    (wrong,) = find_calibration_faults({**outcome, "not_calibrated": ["b"], "passes": False})
    (missed,) = find_calibration_faults({**outcome, "control": "noise", "conclusive": True, "passes": False})
    assert [headline_calibration(one) for one in (few, wrong, missed)] == ["", "", ""]
    _, unconverged = find_calibration_faults({**outcome, "untrusted": 2})
    assert headline_calibration(unconverged) == NOT_CONVERGED
