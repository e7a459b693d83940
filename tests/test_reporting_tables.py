"""Tables: known answers for means, the paper's cells, and what may not be printed."""

import math
import re

import numpy as np
import pandas as pd
import pytest
from pytest import approx
from reporting_results import study, with_frames

from needlefit.datasets import paper
from needlefit.reporting.number_format import format_number, format_to_error
from needlefit.reporting.table import escape_latex, format_cell
from needlefit.reporting.table_files import to_records
from needlefit.schemas.medium import ParameterRecord, PriorRecord
from needlefit.studies.fit_tables import (
    describe_largest_factor,
    lay_out_estimates,
    lay_out_parameters,
    list_undetermined,
)
from needlefit.studies.identification import FROM_PRIOR
from needlefit.studies.scored_groups import aggregate, compare_methods, list_groups, tabulate_errors

BY = ("role", "method", "boundaries")


def two_needles(errors_mm=(1.0, 3.0), deflections_mm=(2.0, 1.0), converged=(True, True)):
    """Two held-out needles, each missed by the same distance everywhere."""
    rows, shapes = [], []
    errors = study(1).frames["errors"]
    template = errors.query("role == 'validate' and method == 'fitted' and boundaries == 'measured'")
    for i, (error, bend) in enumerate(zip(errors_mm, deflections_mm, strict=True)):
        row = template.iloc[0].to_dict() | {"insertion": f"needle{i}", "layers": 3}
        row["hole"] = row["insertion"]
        row |= dict.fromkeys(("median_err_mm", "ipe_mean_mm", "ipe_max_mm", "te_mm"), error)
        row |= {"ipe_std_mm": 0.0, "edp_percent": 100 * error / bend, "deflection_mm": bend}
        rows.append(row | {"edp_flagged": bend < 0.1, "converged": converged[i]})
        x = np.linspace(0, 50, 101)
        points = {
            "measured_x_mm": x,
            "measured_y_mm": bend * x / 50,
            "simulated_x_mm": x,
            "simulated_y_mm": error + bend * x / 50,
        }
        key = {name: row[name] for name in ("fold", "role", "insertion", "method", "boundaries")}
        shapes.append(pd.DataFrame(points).assign(j=np.arange(101), **key))
    return with_frames(study(1), errors=pd.DataFrame(rows), shapes=pd.concat(shapes))


def by_metric(frame, column="value"):
    return {row["metric"]: row[column] for row in to_records(frame)}


def test_errors_are_means_over_insertions():
    two = two_needles()
    table = aggregate(two.frames["errors"], BY)
    values = by_metric(table)
    assert (values["ipe_mean_mm"], values["te_mm"], values["ipe_std_mm"]) == (2.0, 2.0, 0.0)
    assert values["edp_percent"] == approx((50 + 300) / 2)
    assert set(table["insertions"]) == {2}


def test_an_insertion_without_an_answer_is_counted_and_in_no_mean():
    table = aggregate(two_needles((1.0, math.nan), converged=(True, False)).frames["errors"], BY)
    assert by_metric(table)["te_mm"] == 1.0
    assert set(zip(table["insertions"], table["not_converged"], strict=True)) == {(2, 1)}


def test_a_deflection_under_the_floor_is_flagged_and_the_rest_is_given_without_it():
    table = tabulate_errors("validation", two_needles((1.0, 3.0), (2.0, 0.05)))
    assert set(table["edp_flagged"]) == {1}
    assert by_metric(table, "unflagged")["edp_percent"] == 50.0
    assert by_metric(table)["edp_percent"] == approx((50 + 6000) / 2)


def test_baselines_are_compared_on_the_same_insertions():
    one = two_needles((1.0, 3.0))
    method = one.frames["errors"].assign(method="constant_curvature", te_mm=[0.5, 2.0])
    alone = one.frames["errors"].iloc[:1].assign(method="straight", te_mm=9.0)
    both = with_frames(one, errors=pd.concat([one.frames["errors"], method, alone]))
    table = {row["method"]: row for row in to_records(compare_methods(both))}
    assert table["constant_curvature"]["difference_mm"] == approx((-0.5 - 1.0) / 2)
    assert table["constant_curvature"]["difference_se_mm"] == approx(0.25)
    assert table["constant_curvature"]["better"] == 0
    assert (table["straight"]["insertions"], table["straight"]["difference_mm"]) == (1, 8.0)
    assert table["straight"]["difference_se_mm"] is None


def test_the_validation_table_has_every_cell_of_the_paper():
    published = paper.read_published_table("validation")
    runs = [study(n) for n in range(1, 6)]
    table, groups = (
        tabulate_errors("validation", *runs),
        [group for run in runs for group in list_groups(run)],
    )
    assert table.drop_duplicates(["study", "medium", "layers", "method", "boundaries", "metric"]).equals(
        table
    )
    for group, row in zip(groups, to_records(published), strict=True):
        head = [group.study, group.medium, group.layers]
        assert head == [row[name] for name in ("study", "validate_medium", "validate_layers")]
        metrics = list(published.columns[3:])
        assert [group.get(name, "paper") for name in metrics] == [row[name] for name in metrics]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        *[(0.0847, "0.0847"), (213000, "2.13e5"), (1e3, "1000"), (999.6, "1000"), (9999, "1e4")],
        *[(1e8, "1e8"), (0.00012, "1.2e-4"), (-3.0, "-3"), (0.0, "0"), (None, ""), (math.nan, "")],
        (7455.0, "7460"),
    ],
)
def test_numbers_have_three_digits_and_read_back(value, words):
    assert format_number(value) == words
    if words:
        assert float(words) == approx(value, rel=5e-3)


def test_latex_escapes():
    assert escape_latex("50 % of a_b & {c}") == r"50 \% of a\_b \& \{c\}"
    assert escape_latex("2 × 10⁻⁵ Pa, μ₁") == r"2 $\times$ 10$^{-5}$ Pa, $\mu_{1}$"
    assert escape_latex("μ₁^0.28 / b^-2") == r"$\mu_{1}^{0.28}$ / b$^{-2}$"
    assert (
        format_cell("−2.13 × 10⁵") == r"\num{-2.13e5}" and format_cell("0.87 ± 0.7") == r"\num{0.87 \pm 0.7}"
    )
    assert format_cell("1 × 10⁵ to 3 × 10⁵") == r"\numrange{1e5}{3e5}"
    assert escape_latex("a\\b") == r"a\textbackslash{}b"


def test_of_several_folds_values_and_intervals_are_enveloped():
    results = study(1)
    row = (
        results.frames["parameters"].query("method == 'fitted' and parameter == 'bevel_mm'").iloc[0].to_dict()
    )
    row |= {"status": "free", "bound_low": 1e-3, "bound_high": 1.0}
    one = {"fold": "one", "median": 0.1, "interval_low": 0.08, "interval_high": 0.12, "determined": "yes"}
    two = {"fold": "two", "median": 0.2, "interval_low": 0.15, "interval_high": 0.25}
    folds = [{**row, **one}, {**row, **two, "determined": "only together"}]
    frame = pd.DataFrame(folds)
    results = with_frames(results, parameters=frame)
    (cells,), estimates = lay_out_parameters(results).rows, lay_out_estimates(results)
    assert cells[2] == estimates.rows[0][1] == "0.1 to 0.2 (0.08 to 0.25)"

    medium = results.metadata.medium.model_copy(deep=True)
    prior = PriorRecord(median=0.05, factor=1.3)
    medium.parameters["bevel_mm"] = ParameterRecord(bounds=(1e-3, 1.0), prior=prior)
    (note,) = set(lay_out_estimates(results.with_metadata(medium=medium)).notes) - set(estimates.notes)
    assert re.findall(r"[\d.]*\d", note) == ["0.05", "1.3"]


def test_what_reaches_a_bound_or_follows_its_prior_is_not_determined():
    """A wide interval is a measurement: only its factor is stated."""
    results = study(1)
    row = results.frames["parameters"].query("method == 'fitted' and parameter == 'mu1_pa'").iloc[0].to_dict()
    row |= {"interval_low": 1e4, "interval_high": 1e6, "determined": "no"}
    runs = [
        with_frames(results, parameters=pd.DataFrame([{**row, **changes}]))
        for changes in ({}, {"condition": FROM_PRIOR}, {"interval_high": row["bound_high"]})
    ]
    assert [len(list_undetermined(run)) for run in runs] == [0, 1, 1]
    assert [describe_largest_factor(run) for run in runs[:2]] == ["100", "100"]


def test_a_value_that_is_read_in_another_unit_than_its_row_has_its_own():
    results = study(1)
    ours = (
        results.frames["parameters"].query("method == 'fitted' and parameter == 'mu1_pa'").iloc[0].to_dict()
    )
    ends = {"status": "free", "median": 7.64e2, "interval_low": 4e2, "interval_high": 9e2}
    least = {"method": "fitted_metric", "value": 1e8, "low": 500.0, "high": 5e8, "bound_high": 1e9}
    frame = pd.DataFrame([{**ours, **ends}, {**ours, **ends, **least}])
    (cells,) = lay_out_parameters(with_frames(results, parameters=frame)).rows
    assert "100 MPa (0.5 to 500 MPa)" in cells


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (2.714, 0.21, "3"),
        (2.714, 0.13, "2.7"),
        (2.714, 0.021, "2.7"),
        (2.714, 0.019, "2.71"),
        (2.7149, 1e-5, "2.71"),
        (2.714, None, "2.7"),
        (13.14, math.nan, "13"),
        (13.14, 3.0, "13"),
    ],
)
def test_a_number_has_the_digits_that_its_error_supports(value, error, text):
    assert format_to_error(value, error) == text
