"""The judge: checks and verdicts of one fit, and of several by paired differences."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from numpy.testing import assert_allclose
from pytest import approx
from reporting_results import stereo, study, with_frames, with_predictions

from needlefit.project.result_warnings import ResultWarning, to_stored_rows
from needlefit.studies.first_page import Check, Outcome
from needlefit.studies.judge import (
    Comparison,
    Judgement,
    compare_predictions,
    compare_with_curves,
    compare_with_references,
    join_trials,
    judge,
    judge_fits,
    list_checks,
)
from needlefit.studies.prediction_scores import tabulate_coverage
from needlefit.studies.scored_groups import GROUPINGS, find_paper_row, orient_pits


def needles(**te_mm):
    """Return tip errors of methods on needles n1, n2, ... of one fit, each in a hole of one specimen."""
    count = len(next(iter(te_mm.values())))
    names = [f"n{number}" for number in range(1, count + 1)]
    about = pd.DataFrame({"fold": "all", "specimen": "p", "hole": names, "insertion": names})
    about = about.assign(
        tip_across_sd_mm=0.1, tip_registered_sd_mm=0.0, tip_error_x_mm=0.0, tip_error_z_mm=0.0
    )
    rows = [
        about.assign(method=method, te_mm=np.abs(off), tip_error_y_mm=off) for method, off in te_mm.items()
    ]
    return pd.concat(rows)


def compare(ours, straight, constant_curvature, noise=0.1, margin=None, **others):
    references = {"straight": straight, "constant_curvature": constant_curvature}
    errors = needles(fitted=ours, **references, **others)
    if noise is None:
        errors = errors.assign(tip_across_sd_mm=0.0)
    return compare_with_references(errors, "fitted", noise, margin)


@pytest.mark.parametrize(
    ("ours", "straight", "constant", "noise", "margin", "outcome"),
    [
        (0.10, 0.30, 0.45, 0.1, None, "closer than both"),
        (0.10, -0.11, 0.45, 0.1, None, "bend too little"),
        (0.45, 0.10, 0.90, 0.1, None, "worse than one"),
        (0.45, 0.90, 0.10, 0.1, None, "worse than one"),
        (0.30, -0.32, 0.90, 0.1, None, "as close"),
        (0.10, 0.30, 0.45, 0.1, 0.3, "as close"),  # the stated margin
        (0.10, 0.30, 0.45, 0.1, 0.01, "closer than both"),
        (0.19, 0.40, 0.45, None, None, "undecided"),
        (0.19, 0.40, 0.45, None, 0.2, "closer than both"),
        (0.45, 0.20, 0.45, None, 0.2, "worse than one"),
        (0.19, 0.30, 0.45, None, 0.2, "as close"),
    ],
)
def test_one_fit_is_compared_with_two_references(ours, straight, constant, noise, margin, outcome):
    found = compare([ours] * 4, [straight] * 4, [constant] * 4, noise, margin)
    assert found.outcome == outcome


def test_two_known_predictions_are_compared_in_deviations_of_their_difference():
    """Squares differ by 4 (0.4^2 - 0.1^2); of d = 0.3 the deviation is 2 x 0.3 x 0.1 sqrt(4)."""
    errors = needles(fitted=[0.1] * 4, straight=[0.4] * 4)
    tips = {name: rows.set_index(["specimen", "insertion"]) for name, rows in errors.groupby("method")}
    assert compare_predictions(tips["fitted"], tips["straight"]) == approx((5.0, 3.0))
    # of an error that all have in common it is 2 x 4 x 0.3 x 0.1
    common = tips["fitted"].assign(tip_registered_sd_mm=0.1)
    assert compare_predictions(common, tips["straight"]) == approx((2.5, 1.5))
    # in common to both of two specimens it is that over the root of 2; of needles on both sides, each alone
    index = [("p", "n1"), ("p", "n2"), ("q", "n1"), ("q", "n2")]
    two = (
        one.set_axis(pd.MultiIndex.from_tuples(index, names=common.index.names))
        for one in (common, tips["straight"])
    )
    assert compare_predictions(*two) == approx(np.array([2.5, 1.5]) * np.sqrt(2))
    both = (
        one.assign(tip_error_y_mm=one["tip_error_y_mm"] * [1, -1, 1, -1])
        for one in (common, tips["straight"])
    )
    assert compare_predictions(*both) == approx((5.0, 3.0))
    assert compare_predictions(tips["fitted"], tips["fitted"]) == (0.0, 0.0)


def test_within_twice_the_noise_no_reference_is_better():
    many = 40  # the noise of a mean is small: 0.2 is larger than 0.09 beyond it
    outcomes = [compare([ours] * many, [0.09] * many, [0.5] * many).outcome for ours in (0.199, 0.21)]
    assert outcomes == ["as close", "worse than one"]


def test_other_curves_and_errors_that_are_missing_decide_nothing():
    few = compare([0.1] * 4, [0.9] * 4, [0.8] * 4, quadratic_curvature=[0.01] * 4)
    assert (few.outcome, few.reference, few.reference_error) == (
        "closer than both",
        "constant_curvature",
        0.8,
    )
    assert (few.needles, few.closer, few.margin) == (4, 4, None)
    gaps = compare([np.inf, 0.1, 0.1, 0.1, 0.1], [0.9] * 5, [0.8] * 5)
    assert (gaps.outcome, gaps.needles) == ("closer than both", 4)
    nothing = compare_with_references(needles(fitted=[0.1, 0.2]), "fitted", 0.1)
    assert (nothing.outcome, nothing.reference) == ("undecided", "")


def test_a_word_that_hangs_on_one_needle_names_it():
    found = compare([0.1, 0.1, 0.1, 0.1], [-0.11, -0.11, -0.11, 2.0], [3.0] * 4)
    assert (found.outcome, found.hangs_on, found.closer) == ("closer by one needle", ("n4",), 4)
    found = compare([0.1, 0.9, 0.1, 0.1], [0.3, 0.3, 0.3, 0.3], [3.0] * 4)
    assert (found.outcome, found.hangs_on, found.closer) == ("worse than one", ("n2",), 3)
    assert compare([0.1], [0.9], [0.9]).hangs_on == ()


@pytest.mark.parametrize(
    ("reference", "margin", "within"),
    [(0.25, 0.13, True), (0.25, 0.125, False), (0.01, 0.12, True), (None, 0.16, False), (0.25, None, False)],
)
def test_a_difference_below_the_margin_is_within_it(reference, margin, within):
    found = Comparison(Outcome.AS_CLOSE, "straight", reference, margin, 16, 9, ())
    judged = Judgement(Outcome.AS_CLOSE, "te_mm", 0.125, 0.7, "straight", reference, 1, 1, found)
    assert judged.is_within_margin is within and not replace(judged, compared=None).is_within_margin


def test_depths_of_one_hole_are_one_needle():
    errors = needles(fitted=[0.1] * 4, straight=[0.9, 0.9, 0.05, 0.9], constant_curvature=[3.0] * 4)
    found = compare_with_references(errors.assign(hole=[*"aabb"] * 3), "fitted", 0.1)
    assert (found.needles, found.closer, found.hangs_on) == (2, 2, ())
    errors = needles(fitted=[0.1] * 4, straight=[-0.11, -0.11, 2.0, 2.0], constant_curvature=[3.0] * 4)
    assert compare_with_references(errors.assign(hole=[*"aabb"] * 3), "fitted", 0.1).hangs_on == ("b",)


def with_tip_errors(results, **mm):
    """Replace the tip errors of methods, along y, by mean and alternating deviation; the floor is 0.22 mm.

    Measured tips err by 0.18 mm, each by itself, where a floor is known.
    """
    errors = results.frames["errors"].assign(tip_error_y_mm=results.frames["errors"]["te_mm"])
    for method, (mean, deviation) in mm.items():
        rows = errors["method"] == method
        number = pd.factorize(errors.loc[rows, "insertion"])[0]
        errors.loc[rows, "tip_error_y_mm"] = mean + deviation * np.where(number % 2, 1, -1)
    errors["te_mm"] = errors["tip_error_y_mm"].abs()
    sd = np.where(errors["floor_te_mm"].notna(), 0.18, 0.0)
    others = dict.fromkeys(("tip_registered_sd_mm", "tip_error_x_mm", "tip_error_z_mm"), 0.0)
    return with_frames(results, errors=errors.assign(tip_across_sd_mm=sd, **others))


CURVES = dict.fromkeys(("straight", "constant_curvature", "linear_curvature"), (9.0, 0.0))


def with_line(fitted, straight, last=None, floor=0.22):
    """Return study 4 with tip errors, mm, of the fit and a straight line, and of that at the last needle."""
    errors = study(4).frames["errors"].assign(floor_te_mm=floor)
    asked = {**CURVES, "fitted": (fitted, 0.0), "straight": (straight, 0.0)}
    results = with_tip_errors(with_frames(study(4), errors=errors), **asked)
    errors = results.frames["errors"]
    if last is not None:
        at = (errors["method"] == "straight") & (errors["insertion"] == errors["insertion"].iloc[-1])
        errors.loc[at, ["te_mm", "tip_error_y_mm"]] = last
    return results


#: errors as above, and what follows from them: outcome, status, whether the model is closer, and the advice
VERDICTS = [
    ((0.1, 0.5), "closer than both", "pass", True, "predictable"),
    ((1.0, 2.0), "closer than both", "warn", True, "other_medium_missed"),  # five times the noise
    ((0.1, -0.11, 3.0), "closer by one needle", "warn", None, "one_needle_decides"),
    ((0.1, -0.11), "bend too little", "warn", None, "bend_too_little"),
    ((0.3, -0.31), "as close", "warn", None, "curve_as_good"),
    ((0.44, 9.0), "closer than both", "pass", True, "predictable"),  # twice the noise
    ((2.0, 1.0), "worse than one", "fail", False, "other_medium_missed"),
    ((0.1, 0.5, None, np.nan), "undecided", "warn", None, "margin_unstated"),
]


def test_status_check_and_advice_follow_from_one_outcome():
    for errors, outcome, status, is_closer, advice in VERDICTS:
        results = with_line(*errors)
        (verdict,) = results.verdicts
        found = verdict.numbers["outcome"], verdict.status, find(results, Check.CURVES).passed
        assert (*found, results.first_page.advice.finding) == (outcome, status, is_closer, advice), errors
    numbers = with_line(0.1, 0.5).verdicts[0].numbers
    assert [numbers[name] for name in ("te_mm", "te_over_floor", "baseline_te_mm")] == approx(
        [0.1, 0.1 / 0.22, 0.5]
    )
    assert (numbers["baseline"], numbers["paper_te_mm"]) == ("straight", 2.19)
    judged = [judge(with_line(*errors)) for errors in ((0.1, 0.5), (0.22, 0.1), (2.0, 1.0))]
    assert [one.curve_is_closer for one in judged] == [False, True, True]
    assert [one.equals_noise for one in judged] == [False, True, False] and judged[0].has_reference
    assert replace(with_line(0.1, 0.5), interrupted=True).verdicts[0].status == "warn"


def find(results, check):
    return next(one for one in list_checks(results) if one.check is check)


@pytest.mark.parametrize(
    ("trials", "levels", "intervals", "half"),
    [
        (7, (0.1, 0.4, 0.7, 0.97), True, True),
        (7, (0.9999,), False, False),
        (7, (0.5,), True, False),  # too many in the 50 % intervals
        *((trials, (0.3,), True, half) for trials, half in ((3, None), (4, False))),
        # one fit has no interval; that no tip lies in its 95 % interval is unlikely all the same
        *((1, levels, None, None) for levels in ((0.5,), (0.5, 0.9999))),
        (1, (0.9999,), False, None),
    ],
)
def test_coverage_of_several_trials_has_an_interval(trials, levels, intervals, half):
    results = with_predictions(study(1), levels)
    found = {one.check: one for one in list_checks(results if trials == 1 else by_trials(results, trials))}
    assert (found[Check.INTERVALS].passed, found[Check.COVERAGE_50].passed) == (intervals, half)
    tips = 7 if trials == 1 else trials
    assert (found[Check.INTERVALS].trials, found[Check.INTERVALS].tips) == (trials, tips)


def by_trials(results, count=None):
    """Give each prediction, or `count` of them, a fit and a specimen of its own."""
    predictive = results.frames["predictive"].iloc[:count]
    numbers = [str(number) for number in range(len(predictive))]
    return with_frames(results, predictive=predictive.assign(fold=numbers, specimen=numbers))


def test_the_width_that_serves_for_aiming_is_a_key_of_the_recipe():
    results = by_trials(with_predictions(study(1)))
    recipe = results.metadata.recipe.model_copy(update={"aiming_width_mm": 0.5})
    wide = results.with_metadata(recipe=recipe)
    assert [find(one, Check.INTERVALS).passed for one in (results, wide)] == [True, True]
    widths = [find(one, Check.WIDTH) for one in (results, wide)]
    assert [width.passed for width in widths] == [True, False]
    assert widths[0].value == approx(0.6) and widths[1].threshold == 0.5


def test_warnings_about_the_data_are_one_check():
    results = study(4)
    assert find(results, Check.DATA).passed
    kinds = ("noise_too_large", "validity", "copy")
    warned = to_stored_rows(ResultWarning(kind, "") for kind in kinds)
    found = find(results.with_metadata(warnings=warned), Check.DATA)
    assert (found.passed, found.threshold) == (False, 0)
    assert found.named == "copy, noise_too_large, validity"


def pairs(gaps, fold=None, specimen=None, hole=None):
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
    assert found["difference"] == approx(gaps.mean())
    for side, alternative in (("p_smaller", "less"), ("p_larger", "greater")):
        exact = scipy.stats.ttest_1samp(gaps, 0, alternative=alternative).pvalue
        assert found[side] == approx(exact)


@pytest.mark.parametrize(
    ("te", "crps", "outcome"),
    [
        (-0.3, -0.3, "generalises"),
        (-0.3, 0.0, "not shown"),
        (0.0, -0.3, "not shown"),
        (0.0, 0.3, "does not generalise"),
        (-0.3, 0.3, "does not generalise"),
        (0.3, -0.3, "does not generalise"),
        (0.026, -0.3, "not shown"),  # p = 0.04, of two comparisons
        (0.035, -0.3, "does not generalise"),
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
    assert two["trials"] == 2 and two["p_smaller"] == approx(
        scipy.stats.ttest_1samp(means, 0, alternative="less").pvalue
    )


def test_several_fits_generalise_only_where_they_beat_every_curve():
    results = stereo()
    near = {"fitted": (0.1, 0.01), "straight": (2.0, 0.01)}
    others = {"constant_curvature": (1.0, 0.02), "linear_curvature": (1.5, 0.02)}
    outcomes = []
    for changed in (
        {},
        {"constant_curvature": (0.1, 0.0)},
        *({"straight": (0.01, 0.0), "fitted": (mm, 0.01)} for mm in (2.0, 0.3)),
    ):
        one = with_tip_errors(results, **{**near, **others, **changed})
        judged = judge(one)
        outcomes.append((judged.outcome, find(one, Check.CURVES).passed, judged.curve, judged.advice))
        assert not judged.has_reference
    assert outcomes == [
        ("generalises", True, "constant_curvature", ""),
        ("not shown", None, "constant_curvature", "closer_undecided"),
        ("does not generalise", False, "straight", "curve_closer"),
        ("does not generalise", False, "straight", "curve_as_good"),  # within twice the noise
    ]


def test_the_crps_of_predicted_tips_is_judged_too():
    results = with_predictions(with_tip_errors(stereo(), **{**CURVES, "fitted": (0.1, 0.01)}))
    errors, predictive = results.frames["errors"], results.frames["predictive"]
    ours = errors.query("method == 'fitted' and role == 'validate'").assign(method="prediction")
    outcomes = []
    for crps in (0.1, 10.0):
        frames = {"errors": pd.concat([errors, ours]), "predictive": predictive.assign(tip_crps_mm=crps)}
        outcomes.append(with_frames(results, **frames).verdicts[0].numbers["outcome"])
    assert outcomes == ["generalises", "does not generalise"]


def test_tracks_are_judged_by_their_readings():
    about = {"hole": list("abcd"), "insertion": list("abcd"), "specimen": list("pqrs")}
    ours = pd.DataFrame({**about, "method": "fitted", "track_rms_mm": [0.5, 0.6, 0.5, 0.4]})
    line = pd.DataFrame({**about, "method": "straight", "track_rms_mm": 1.0})
    runs = pd.concat([ours.assign(shape_crps_mm=0.3), line.assign(shape_crps_mm=0.8)])
    several, of_one = runs.assign(fold=[*"1234"] * 2), runs.assign(fold="all", specimen="p")
    assert judge_fits(several, "fitted", "track_rms_mm") == "generalises"

    def compare(noise, margin):
        return compare_with_references(of_one, "fitted", noise, margin, "track_rms_mm").outcome

    assert compare(None, None) == "undecided"  # no noise is stated
    assert [compare(None, margin) for margin in (0.4, 0.6)] == ["closer than both", "as close"]
    assert [compare(noise, None) for noise in (0.4, 0.6)] == ["closer than both", "as close"]


def test_a_fit_is_compared_with_the_references_on_its_own_needles():
    results = with_tip_errors(study(1), **{**CURVES, "fitted": (0.1, 0.0), "straight": (0.05, 0.0)})
    results = with_predictions(results)  # which are of others
    fit = with_frames(results, errors=results.frames["errors"].query("role == 'tune'"))
    found = find(fit, Check.CURVES)
    assert (found.passed, found.needles, found.closer, found.threshold) == (None, 9, 0, approx(0.05))
    assert Check.INTERVALS not in {one.check for one in list_checks(fit)}


def test_differences_are_tested_from_three_trials_on():
    results = with_tip_errors(stereo(), **{**CURVES, "fitted": (0.1, 0.0)})
    errors = results.frames["errors"]
    third = errors["specimen"].unique()[2]
    outcomes = []
    for one in (results, with_frames(results, errors=errors[errors["specimen"] != third])):
        judged = judge(one)
        outcomes.append((judged.trials, judged.outcome, judged.compared is None))
    assert outcomes == [(3, "generalises", True), (2, "closer than both", False)]


def test_data_that_contradict_themselves_forbid_every_word():
    kinds = {"copy": "undecided", "placeholder": None}
    for fitted, word in ((0.1, "closer than both"), (2.0, "worse than one")):
        good = with_line(fitted, 1.0)
        for kind, outcome in kinds.items():
            warned = good.with_metadata(warnings=to_stored_rows([ResultWarning(kind, "")]))
            assert judge(warned).outcome == (outcome or word)
            assert warned.verdicts[0].status == ("warn" if outcome else good.verdicts[0].status)


@pytest.mark.parametrize("turns", [True, False])
def test_a_verdict_is_withheld_only_if_it_turns_without_the_odd_needles(turns):
    good = with_line(0.1, 1.0)
    effect = {"insertions": ["n5"], "outcome": "as close", "turns": turns, "values": {"mu1_pa": [2e5, 4e5]}}
    run = good.with_metadata(effect=effect)
    assert judge(run).outcome == ("undecided" if turns else "closer than both")
    found = {one.check: one for one in run.first_page.checks}[Check.SAME]
    assert (found.passed, found.left_out, found.outcome) == (not turns, "n5", "as close")

    copied = run.with_metadata(warnings=to_stored_rows([ResultWarning("copy", "", insertions=("n5",))]))
    assert copied.verdicts[0].numbers["outcome"] == ("undecided" if turns else "closer than both")
    both = run.with_metadata(warnings=to_stored_rows([ResultWarning("copy", "", insertions=("n5", "n6"))]))
    assert both.verdicts[0].numbers["outcome"] == "undecided"


def test_a_margin_and_what_it_is_for_are_keys_of_the_study():
    record = study(4).record
    stated = {"margin_mm": 2.0, "margin_for": "biopsy"}
    results = with_line(0.1, 1.0)
    wide = replace(results, record=record.model_copy(update=stated))
    assert [one.verdicts[0].numbers["outcome"] for one in (results, wide)] == ["closer than both", "as close"]
    for key in stated:
        with pytest.raises(ValueError, match="margin_for"):
            type(record).model_validate({**record.model_dump(by_alias=True), key: stated[key]})


def test_tips_without_an_interval_are_counted():
    results = with_predictions(study(3))
    kept = with_frames(results, predictive=results.frames["predictive"].iloc[:-2])
    for run, missing in ((results, 0), (kept, 2)):
        found = {one.check: one for one in list_checks(run)}
        assert found[Check.INTERVALS].missing == found[Check.COVERAGE_50].missing == missing


def test_tips_that_deflect_more_than_predicted_are_counted():
    predictive = with_predictions(study(1)).frames["predictive"]
    nearer = predictive["tip_measured_mm"] * np.where(np.arange(len(predictive)) < 3, 0.9, 1.1)
    for sign in (1, -1):
        shown = predictive.assign(
            tip_median_mm=sign * nearer, tip_measured_mm=sign * predictive["tip_measured_mm"]
        )
        in_space = shown.assign(
            tip_z_median_mm=0.0, tip_z_measured_mm=0.0, tip_z_95_low_mm=0.0, tip_z_95_high_mm=0.0
        )
        for rows in (shown, in_space):
            found = {one.check: one for one in list_checks(with_frames(study(1), predictive=rows))}
            assert (found[Check.COVERAGE_50].beyond, found[Check.INTERVALS].beyond) == (3, None)


def test_pits_of_tips_are_toward_the_bevel_in_a_plane_and_as_stored_in_space():
    run = with_predictions(study(2), (0.1,))
    shapes = run.frames["shapes"].copy()
    turned = shapes["insertion"] == run.frames["predictive"]["insertion"].iloc[0]
    shapes.loc[turned, "measured_y_mm"] *= -1  # its deflection stays: its bevel faces the other side
    mirrored = with_frames(run, shapes=shapes)
    plain, other = orient_pits(run)["tip"], orient_pits(mirrored)["tip"]
    assert sorted({plain[0], other[0]}) == approx([0.1, 0.9])
    assert_allclose(other[1:], plain[1:])
    assert_allclose(orient_pits(mirrored)["shape"], 0.1)
    space = replace(mirrored, metadata=mirrored.metadata.state(compared="space"))
    assert_allclose(orient_pits(space)["tip"], 0.1)


def test_the_share_of_covered_tips_stands_with_its_interval():
    predictions = with_predictions(study(2)).frames["predictive"].iloc[:4].copy()
    predictions["fold"] = predictions["specimen"] = [f"f{number}" for number in range(4)]
    # levels 0.1, 0.4, 0.7, 0.97: two within 50 %, four within 95 %; Wilson's intervals by hand
    found = tabulate_coverage(predictions)
    assert (found["tip_in_50"], found["tip_in_95"]) == ("2 (15–85 %)", "4 (51–100 %)")
    unknown = tabulate_coverage(predictions.assign(tip_in_50=np.nan))  # of curvatures alone
    assert (unknown["tip_in_50"], unknown["tip_in_95"]) == (None, "4 (51–100 %)")


@pytest.mark.parametrize(
    ("medium", "layers", "te_mm", "insertions"),
    [
        ("phantom1", 3, 0.29, 10),
        ("phantom2", 4, 0.44, 9),
        ("chicken", 1, 0.35, 12),
        ("phantom1", 2, None, None),
    ],
)
def test_fitted_insertions_stand_beside_the_table_of_the_paper_that_holds_them(
    medium, layers, te_mm, insertions
):
    """By layers, or by media where all insertions of a medium have as many layers."""
    group = {"medium": medium, "layers": layers, "grouping": GROUPINGS["tuning"]}
    row, count = find_paper_row(group)
    assert (row.get("te_mm"), count) == (te_mm, insertions)
