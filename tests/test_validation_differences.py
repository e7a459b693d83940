import json
import re

import numpy as np
import pandas as pd
import pytest

from needlefit.project.folders import write_manifest
from needlefit.studies.run_differences import compare_runs, lay_out_differences, summarize_differences

ERRORS = pd.DataFrame(
    {
        "fold": "all", "role": "validate", "method": "fitted", "boundaries": "measured",
        "insertion": ["a", "b", "c", "d"],
        "ipe_mean_mm": [0.1, 0.2, 0.3, 0.4], "te_mm": [0.2, 0.4, 0.6, 0.8],
    }
)  # fmt: skip
PARAMETERS = pd.DataFrame(
    {
        "fold": "all", "method": "fitted", "parameter": ["mu1_pa", "mu2_pa", "bevel_mm"],
        "status": ["free", "tied", "free"],
        "value": [1e5, 1e5, 0.1],
        "determined": ["yes", "yes", "no"], "sd": [0.1, np.nan, 0.5],
    }
)  # fmt: skip
RUN = {"kind": "fit", "dataset": {"sha256": "abc"}, "recipe": {"seed": 1, "starts": 8}, "interrupted": False}


def write(folder, errors=ERRORS, parameters=PARAMETERS, **run_changes):
    folder.mkdir()
    errors.to_csv(folder / "errors.csv", index=False)
    parameters.to_csv(folder / "parameters.csv", index=False)
    (folder / "run.json").write_text(json.dumps(RUN | run_changes))
    write_manifest(folder)
    return folder


@pytest.fixture
def first(tmp_path):
    return write(tmp_path / "a")


def test_inputs_are_named_by_their_path_and_matter_by_what_follows(first, tmp_path):
    found = compare_runs(first, write(tmp_path / "same"))
    assert found == [] and re.search(r"\d", summarize_differences(found)) is None
    found = compare_runs(first, write(tmp_path / "b", recipe={"seed": 2, "starts": 8}))
    assert [(one.what, one.where, one.before, one.after, one.matters) for one in found] == [
        ("input", "recipe.seed", 1, 2, None)
    ]
    assert re.findall(r"\d+ \w+", summarize_differences(found)) == ["1 input"]


@pytest.mark.parametrize(("part", "matters"), [(0.3, False), (0.7, True)])
def test_a_parameter_matters_by_its_own_deviation_and_what_is_tied_to_it_does_not_count_twice(
    part, matters, first, tmp_path
):
    moved = PARAMETERS.assign(value=[1e5 * np.exp(0.1 * part), 1e5 * np.exp(0.1 * part), 0.1])
    (one,) = compare_runs(first, write(tmp_path / "b", parameters=moved))
    assert (one.what, one.where, one.matters) == ("parameter", "mu1_pa", matters)
    assert one.why.startswith(f"{part:.2g} ") and "standard deviation" in one.why


def test_undetermined_parameters_may_move_and_verdicts_may_not(first, tmp_path):
    moved = PARAMETERS.assign(value=[1e5, 1e5, 0.3])
    (one,) = compare_runs(first, write(tmp_path / "b", parameters=moved))
    assert not one.matters and one.why.endswith("not determined")
    flipped = PARAMETERS.assign(determined=["yes", "yes", "only together"])
    (one,) = compare_runs(first, write(tmp_path / "c", parameters=flipped))
    assert (one.what, one.before, one.after, one.matters) == ("state", "no", "only together", True)


@pytest.mark.parametrize(
    ("gap", "matters", "slight"),
    [
        ([0.02, 0.02, 0.02, 0.02], True, False),
        ([0.3, -0.3, 0.3, -0.26], False, False),  # as large, but of either sign
        ([0.004, 0.004, 0.004, 0.004], False, False),
        ([1e-6, 1e-6, 0.0, 0.0], False, True),
    ],
)
def test_errors_are_compared_insertion_by_insertion(gap, matters, slight, first, tmp_path):
    changed = ERRORS.assign(ipe_mean_mm=ERRORS["ipe_mean_mm"] + gap)
    (one,) = compare_runs(first, write(tmp_path / "b", errors=changed.iloc[::-1]))
    assert (one.what, one.matters, one.slight) == ("error", matters, slight)
    assert one.after - one.before == pytest.approx(np.mean(gap))
    assert len(lay_out_differences([one]).rows) == (1 if matters else 0)
    assert len(lay_out_differences([one], everything=True).rows) == 1


KINDS_BY_TABLE = {
    "identify": "identification",
    "forecast": "prediction",
    "coverage": "calibration",
    "replicates": "calibration",
}


def table(folder, name, rows):
    folder.mkdir(exist_ok=True)
    (folder / "run.json").write_text(json.dumps({"kind": KINDS_BY_TABLE[name]}))
    return add(folder, name, pd.DataFrame(rows))


def add(folder, name, frame):
    frame.to_csv(folder / f"{name}.csv", index=False)
    write_manifest(folder)
    return folder


def test_a_verdict_and_a_deviation_of_identify_are_compared(tmp_path):
    row = {"fold": "all", "parameter": "mu1_pa", "determined": "yes", "sd": 0.1}
    one = table(tmp_path / "a", "identify", [row])
    two = table(tmp_path / "b", "identify", [{**row, "determined": "no", "sd": 0.2}])
    (two / "run.json").write_text('{"kind": "identification", "dataset": {"name": "other"}}')
    write_manifest(two)
    named, verdict, wider = compare_runs(one, two)
    assert (named.what, named.where, named.after) == ("input", "dataset.name", "other")
    assert (verdict.before, verdict.after, verdict.matters) == ("yes", "no", True)
    assert wider.why.startswith("2 times") and wider.matters
    folds = [table(tmp_path / f"{sd}", "identify", [{**row, "fold": f, "sd": sd} for f in ("one", "two")])
             for sd in (0.1, 0.2)]  # fmt: skip
    assert [found.where for found in compare_runs(*folds)] == [
        f"sd of mu1_pa ({fold})" for fold in ("one", "two")
    ]


def test_a_moved_tip_prediction_is_given_in_its_deviations(tmp_path):
    """A band of 3.92 mm is a deviation of 1 mm: a median that moved by 0.4 mm is what it was, by 0.6 not."""
    row = {"quantity": "needle", "level": 0.95, "s_mm": 50.0, "median_mm": 2.0}
    row |= {"low_mm": 0.04, "high_mm": 3.96}
    one = table(tmp_path / "a", "forecast", [row])
    for moved, matters in ((0.4, False), (0.6, True)):
        (found,) = compare_runs(one, table(tmp_path / "b", "forecast", [{**row, "median_mm": 2.0 + moved}]))
        assert found.why.startswith(f"{moved:g} ") and "standard deviation" in found.why
        assert found.matters is matters


def test_counts_of_a_calibration_matter_where_their_verdict_changed(tmp_path):
    row = {"quantity": "mu1_pa", "level": 0.5, "covered": 50, "passes": True}
    row |= {"count_low": 40, "count_high": 60}
    one = table(tmp_path / "a", "coverage", [row, {**row, "level": 0.9, "covered": 90}])
    changes = [{**row, "covered": 45}, {**row, "level": 0.9, "covered": 70, "passes": False}]
    found = compare_runs(one, table(tmp_path / "b", "coverage", changes))
    assert [(one.where, one.matters) for one in found] == [
        ("mu1_pa, 50 % interval", False),
        ("mu1_pa, 90 % interval", True),
    ]


def tabulate_predictive(treatments, covered=1, width=2.0, crps=0.1):
    frames = [
        pd.DataFrame(
            {
                "fold": "all", "insertion": list("abcdefghij"), "hole": list("abcdefghij"),
                "specimen": "p", "medium": "m", "layers": 1, "specimen_treatment": treatment,
                "quantity": "tip", "level": 0.95, "low_mm": -width / 2,
                "high_mm": width / 2, "covered": [covered] * 3 + [1] * 7, "crps_mm": crps,
            }
        )
        for treatment in treatments
    ]  # fmt: skip
    return pd.concat(frames, ignore_index=True)


def test_what_runs_predict_by_default_is_compared_by_coverage_and_width(first, tmp_path):
    second = write(tmp_path / "b")
    both = pd.concat(
        [tabulate_predictive(["others"], width=2.0), tabulate_predictive(["training only"], 0, 1.2)]
    )
    add(first, "predictive", both)
    add(second, "predictive", tabulate_predictive(["training only"], 0, 1.2))
    covered, width = compare_runs(first, second)
    assert (covered.before, covered.after, covered.matters) == (10, 7, True)
    assert (width.before, width.after, width.matters) == (2.0, 1.2, True)
    add(second, "predictive", tabulate_predictive(["others"], width=2.05))
    (width,) = compare_runs(first, second)
    assert not width.matters
