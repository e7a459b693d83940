"""Tables: known answers for the two ways of averaging, the paper's cells, and what may not be printed."""

import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from reporting_results import sampled, stereo, study

from needlefit.reporting.columns import (
    FORMATS,
    LENGTH_ERROR_FORMAT,
    METRIC_FORMAT,
    Column,
    list_columns,
)
from needlefit.reporting.latex import escape_latex, format_cell, format_latex
from needlefit.reporting.number_format import (
    choose_interval_unit,
    format_mm,
    format_number,
    format_percent,
    format_symbol,
    insert_symbols,
    typeset,
    typeset_interval,
)
from needlefit.reporting.table import Table, TableColumn, TableLayout, drop_repeated, part, pivot
from needlefit.reporting.table_files import to_records
from needlefit.studies import paper
from needlefit.studies.kinds.cross_validation.report import Facts, list_sentences
from needlefit.studies.kinds.cross_validation.tables import (
    arrange_parameters,
    describe_parameter,
    lay_out_parameters,
    lay_out_posterior,
    lay_out_validation,
    lay_out_values,
    tabulate_parameters,
    tabulate_percentiles,
)
from needlefit.studies.report import compose_run_report, say
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import (
    TE,
    aggregate,
    compare_methods,
    find_curves,
    list_groups,
    tabulate_tuning,
    tabulate_validation,
)

BY = ("role", "method", "boundaries")


def two_needles(errors_mm=(1.0, 3.0), deflections_mm=(2.0, 1.0), converged=(True, True)) -> Run:
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
    return study(1).with_frames(errors=pd.DataFrame(rows), shapes=pd.concat(shapes))


def by_metric(frame: pd.DataFrame, column: str = "value") -> dict:
    return {row["metric"]: row[column] for row in to_records(frame)}


def test_macro_is_the_mean_over_insertions_and_pooled_takes_all_points_together():
    two = two_needles()
    table = aggregate(two.frames["errors"], BY)
    values = by_metric(table)
    assert (values["ipe_mean_mm"], values["te_mm"], values["ipe_std_mm"]) == (2.0, 2.0, 0.0)
    assert values["edp_percent"] == pytest.approx((50 + 300) / 2)
    assert set(table["insertions"]) == {2}
    pooled = by_metric(aggregate(two.frames["errors"], BY, find_curves(two.frames["shapes"])), "pooled")
    names = ("ipe_mean_mm", "ipe_std_mm", "ipe_max_mm", "edp_percent")
    assert [pooled[name] for name in names] == pytest.approx([2.0, 1.0, 3.0, 100 * (1 + 3) / (2 + 1)])


def test_an_insertion_without_an_answer_is_counted_and_in_no_mean():
    table = aggregate(two_needles((1.0, math.nan), converged=(True, False)).frames["errors"], BY)
    assert by_metric(table)["te_mm"] == 1.0
    assert set(zip(table["insertions"], table["not_converged"], strict=True)) == {(2, 1)}
    one = two_needles((1.0, math.inf), converged=(True, False))
    shapes = one.frames["shapes"].query("insertion == 'needle0'")
    pooled = by_metric(aggregate(one.frames["errors"], BY, find_curves(shapes)), "pooled")
    assert (pooled["ipe_max_mm"], pooled["edp_percent"]) == pytest.approx((1.0, 50.0))


def test_a_deflection_under_the_floor_is_flagged_and_the_rest_is_given_without_it():
    table = tabulate_validation(two_needles((1.0, 3.0), (2.0, 0.05)))
    assert set(table["edp_flagged"]) == {1}
    assert by_metric(table, "unflagged")["edp_percent"] == 50.0
    assert by_metric(table)["edp_percent"] == pytest.approx((50 + 6000) / 2)


def test_baselines_are_compared_on_the_same_insertions():
    one = two_needles((1.0, 3.0))
    method = one.frames["errors"].assign(method="constant_curvature", te_mm=[0.5, 2.0])
    alone = one.frames["errors"].iloc[:1].assign(method="straight", te_mm=9.0)
    both = one.with_frames(errors=pd.concat([one.frames["errors"], method, alone]))
    table = {row["method"]: row for row in to_records(compare_methods(both, metric=TE))}
    assert table["constant_curvature"]["difference_mm"] == pytest.approx((-0.5 - 1.0) / 2)
    assert table["constant_curvature"]["difference_se_mm"] == pytest.approx(0.25)
    assert table["constant_curvature"]["better"] == 0
    assert (table["straight"]["insertions"], table["straight"]["difference_mm"]) == (1, 8.0)
    assert table["straight"]["difference_se_mm"] is None
    assert "constant curvature (−0.750 ± 0.250 mm" in " ".join(
        list_sentences(both, "conclusion", "ties", "paper_sets")
    )


def test_the_validation_table_has_every_cell_of_the_paper():
    published = paper.read_published_table("validation")
    table = tabulate_validation(*(study(n) for n in range(1, 6)))
    groups = list_groups(table)
    assert table.drop_duplicates(["study", "medium", "layers", "method", "boundaries", "metric"]).equals(
        table
    )
    for group, row in zip(groups, to_records(published), strict=True):
        head = [group.head[name] for name in ("study", "medium", "layers")]
        assert head == [row[name] for name in ("study", "validate_medium", "validate_layers")]
        metrics = list(published.columns[3:])
        assert [group.get(name, "paper") for name in metrics] == [row[name] for name in metrics]


def test_rows_are_json_and_missing_cells_are_null():
    table = tabulate_validation(stereo())
    rows = to_records(table)
    assert json.loads(json.dumps(rows, allow_nan=False)) == rows
    assert table["paper"].isna().all() and "hand_tuned" not in set(table["method"])
    assert rows[0]["study"] == "stereo_insertions"
    assert "no such row" in rows[0]["comparable"]


def test_errors_stand_as_multiples_of_their_floor():
    """Floors are 0.21 mm of IPE and 0.22 mm of TE; both needles are missed by 2 mm on average."""
    (group,) = list_groups(tabulate_validation(two_needles()))
    assert group.over_floor("ipe_mean_mm") == pytest.approx(2 / 0.21)
    assert group.over_floor("te_mm") == group.over_floor("te_mm", "pooled") == pytest.approx(2 / 0.22)
    table = lay_out_validation([two_needles()])
    columns = [f"{column.label} {column.unit}" for column in table.columns]
    ratios = {
        row[4]: (row[columns.index("IPE ÷ floor")], row[columns.index("TE ÷ floor")]) for row in table.rows
    }
    assert ratios["posterior-mode fit"] == ratios["pooled"] == ("9.5", "9.1")
    assert ratios["noise floor"] == ("–", "–")


def test_a_needle_that_ends_at_a_boundary_is_counted_both_ways():
    """Of 4 + 3 layers, 1 + 1 as the study reads them; the other reading has both among those of four."""
    one = two_needles((1.0, 3.0))
    errors = one.frames["errors"].assign(layers=[4, 3], layers_other=[4, 4])
    both = one.with_frames(errors=errors)
    groups = list_groups(tabulate_validation(both, with_alternate=True))
    names = ("layers", "insertions", "alternate_count")
    assert [(*(one.head[name] for name in names), one.get("te_mm")) for one in groups] == [
        (4, 1, False, 1.0),
        (3, 1, False, 3.0),
        (4, 2, True, 2.0),
    ]
    assert [one.head["layer_count_rule"] for one in groups] == ["listed", "listed", "alternative"]
    assert len(list_groups(tabulate_validation(both))) == 2
    table = lay_out_validation([both])
    assert "4‡" in {row[2] for row in table.rows}
    assert any("other way" in note for note in table.notes)


def test_tuning_rows_stand_beside_the_papers_by_layers_and_by_media():
    groups = {one.head["grouping"]: one for one in list_groups(tabulate_tuning(study(1)))}
    found = {name: (one.get("te_mm", "paper"), one.head["paper_insertions"]) for name, one in groups.items()}
    assert found == {"layers": (0.44, 9), "media": (0.37, 16)}
    assert groups["media"].head["layers"] is None


def test_every_parameter_has_a_number_and_a_word_for_what_the_data_determine():
    rows = {row["parameter"]: row for row in arrange_parameters(tabulate_parameters(study(1)))}
    assert all(math.isfinite(row["value"]) for row in rows.values())
    assert {name: row["determined"] for name, row in rows.items() if name.startswith("alpha")} == {
        f"alpha{layer}": "no" for layer in (1, 2, 3, 4)
    }
    facts = Facts(study(1))
    assert facts.loose == ["alpha1", "alpha2", "alpha3", "alpha4"] and facts.together == []
    cells = describe_parameter([rows["mu1_pa"]], truth=2e5)
    assert cells["parameter"] == "μ₁ (kPa)" and cells["true_value"] == "200"
    assert re.fullmatch(r"[\d.]+ \([\d.]+ to [\d.]+\)", cells["posterior"])
    assert cells["error_minimising"] == cells["errors_determine"] == ""


def test_the_error_minimising_fit_has_its_own_range_and_marks_its_bounds():
    one = study(1)
    second = one.frames["parameters"].query("method == 'fitted'").assign(
        method="fitted_metric", determined="no", value=2.5e5, interval_low=1e3, interval_high=4e8,
        bound_low=1e3, bound_high=1e9,
    )  # fmt: skip
    both = one.with_frames(parameters=pd.concat([one.frames["parameters"], second]))
    rows = {row["parameter"]: row for row in arrange_parameters(tabulate_parameters(both))}
    assert describe_parameter([rows["mu1_pa"]])["error_minimising"] == "250 (1* to 4 × 10⁵)".replace(
        "4 × 10⁵", "400000"
    )
    heads = {column.label for column in lay_out_parameters([both]).columns}
    assert "Error-minimising (range)" in heads
    assert "Error-minimising (range)" not in {c.label for c in lay_out_parameters([one]).columns}


def test_a_fixed_parameter_is_given_and_marked_as_fixed():
    row = arrange_parameters(tabulate_parameters(study(5)))[1]
    assert (row["parameter"], row["status"], row["value"], row["determined"]) == ("alpha1", "fixed", 1.0, "")
    assert describe_parameter([row])["posterior"] == "1, fixed"
    assert Facts(study(5)).loose == ["mu1_pa"] and Facts(study(5)).fixed == ["alpha1"]


def test_the_papers_value_is_below_the_models_in_the_same_column():
    table = lay_out_validation([study(1)])
    names = [row[4] for row in table.rows[:5]]
    assert names == ["posterior-mode fit", "planned layer depths", "pooled", "noise floor", "paper"]
    paper = dict(zip(((one.label, one.unit) for one in table.columns), table.rows[4], strict=True))
    assert paper["TE", "mm"] == "0.14" and paper["EDP", "%"] == "5.56"
    assert "0.19 ± 0.13" in table.rows[4]
    flagged = next(row for row in lay_out_validation([study(5)]).rows if row[4] == "posterior-mode fit")
    assert "†" in dict(zip(paper, flagged, strict=True))["EDP", "%"]
    assert any("did not converge" in note for note in lay_out_validation([study(3)]).notes)


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
        assert float(words) == pytest.approx(value, rel=5e-3)


def test_numbers_in_print():
    for text, printed in (("2.13e5", "2.13 × 10⁵"), ("1e-4", "10⁻⁴"), ("-3", "−3")):
        assert typeset(text) == printed
    percents = [format_percent(v) for v in (4.77, 10.3, 254.2, 9.996, None)]
    assert percents == ["4.77", "10.3", "254", "10.0", "–"] and format_mm(math.nan) == "–"
    symbols = [format_symbol(n) for n in ("mu1_pa", "alpha12", "bevel_mm", "odd")]
    assert symbols == ["μ₁ (Pa)", "α₁₂", "b (mm)", "odd"]
    assert insert_symbols("mu1 and bevel_mm only as mu1_pa * bevel_mm^1.9") == "μ₁ and b only as μ₁ · b^1.9"
    text = insert_symbols("alpha2 (fixed at -1), -3 to 5, b^-2 and 2e-3")
    assert text == "α₂ (fixed at −1), −3 to 5, b^-2 and 2 × 10⁻³"


def test_a_row_has_one_unit_which_fits_its_largest_printed_value():
    row = {"parameter": "mu1_pa", "interval_low": 71.2e3, "interval_high": 14.4e6}
    row |= {"bound_low": 1e3, "bound_high": 1e12}
    label, unit = choose_interval_unit(row, 2e5)
    assert (label, unit) == ("μ₁ (MPa)", 1e6) and typeset_interval(row, unit) == "0.0712 to 14.4"


def test_latex_is_booktabs_with_every_sign_escaped():
    page = format_latex(lay_out_validation([study(1)]), synthetic=True)
    body = page.split(r"\midrule")[1].split(r"\bottomrule")[0]
    rows = [line for line in body.splitlines() if line.endswith(r"\\")]
    columns = len(lay_out_validation([study(1)]).columns)
    assert all(line.replace(r"\&", "").count("&") == columns - 1 for line in rows)
    assert len(rows) == 15
    assert r"\caption{SYNTHETIC DATA. " in page
    assert r"$\pm$" in page
    assert page.isascii()
    assert "SYNTHETIC" not in format_latex(lay_out_validation([stereo()]), synthetic=False)


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
    (cells,) = lay_out_values(results.with_frames(parameters=pd.DataFrame(folds))).rows
    assert cells[1] == "0.1 to 0.2 (0.08 to 0.25)" and cells[2] == "only together"


@pytest.mark.parametrize("value", [-0.0, -0.001])
def test_zero_has_no_sign(value):
    assert "-" not in format_mm(value) + format_number(value * 0.0) and float(format_mm(value)) == 0


def fitted(results: Run) -> float:
    table = results.frames["parameters"].query("method == 'fitted' and parameter == 'bevel_mm'")
    return float(table["value"].iloc[0])


def test_a_fit_outside_the_central_95_percent_is_reported():
    outside = sampled(fitted(study(5)) - 0.001, 0.15)  # a draw is lower, but not 2.5 % of them
    assert to_records(tabulate_percentiles(outside))[0]["fit_in_central_95"] is False
    by_metric = say(outside, "outside_fits")
    assert "95 %" in by_metric and re.search(r"\bb\b", by_metric) and "error bars" in by_metric
    peak = outside.with_frames(starts=outside.frames["starts"].assign(minimized="posterior"))
    assert "95 %" in say(peak, "outside_fits") and "error bars" not in say(peak, "outside_fits")
    assert "‡" in "".join(lay_out_posterior(outside).rows[0])
    blocks = compose_run_report(outside, {}).blocks
    assert say(outside, "outside_fits") in [block.get("text") for block in blocks]
    assert "posterior" in [block.get("name") for block in blocks]


def test_an_unconverged_posterior_is_flagged_in_every_output():
    loose = sampled(0.05, 0.15, r_hat=1.2)
    warning = say(loose, "unconverged")
    assert warning.startswith("NOT CONVERGED") and "R-hat of bevel_mm" in warning
    assert re.findall(r"\d\.\d+", warning)[:2] == ["1.2", "1.02"]  # the value and its limit
    layout = lay_out_posterior(loose)
    assert "NOT CONVERGED" in layout.caption and "NOT CONVERGED" in layout.rows[0]
    assert to_records(tabulate_percentiles(loose))[0]["converged"] is False
    assert warning in [block.get("text") for block in compose_run_report(loose, {}).blocks]
    fine = sampled(0.05, 0.15)
    assert say(fine, "unconverged") == "" and "NOT CONVERGED" not in lay_out_posterior(fine).caption


def test_columns_have_explanations_of_their_own():
    columns = list_columns()
    explanations = [one.explanation for one in columns.values()]
    assert all(explanations) and len(set(explanations)) == len(explanations)
    formats = {
        form for one in columns.values() for form in re.findall(r":(\w+)}", one.format) or [one.format]
    }
    assert formats <= {*FORMATS, METRIC_FORMAT, LENGTH_ERROR_FORMAT}


def test_a_template_composes_columns():
    column = Column("gain", format="{value:mm3}[ ± {sd:mm}]")
    rows = ({"value": 1.0, "sd": 0.5}, {"value": 1.0, "sd": None}, {"value": None, "sd": 0.5})
    assert [column.format_cell(row) for row in rows] == ["1.000 ± 0.50", "1.000", "–"]
    ends = Column("range", format="[{low:mm} to {high:mm}]")
    rows = (
        {"low": 1, "high": 2},
        {"low": 1, "high": 1.001},
        {"low": None, "high": 2},
        {"low": "", "high": 2},
    )
    assert [ends.format_cell(row) for row in rows] == ["1.00 to 2.00", "1.00", "", ""]
    assert Column("value", format="mm").format_cell({"value": "not determined"}) == "not determined"


def test_pivoted_rows_have_a_column_for_each_place():
    names = ("study", "metric", "value", "over_floor")
    values = (("a", "te_mm", 1.0, 2.0), ("a", "edp_percent", 30.0, 4.0), ("b", "te_mm", 2.0, None))
    rows = pivot([dict(zip(names, one, strict=True)) for one in values], ["study"], ["metric"])
    places = ("te_mm", "edp_percent")
    columns = ("study", *(part(key, metric=name) for key in ("value", "over_floor") for name in places))
    table = Table("t", rows, columns).lay_out()
    assert table.rows == (("a", "1.00", "30.0", "2.0", "4.0"), ("b", "2.00", "–", "–", "–"))
    heads = [(one.label, one.unit) for one in table.columns[1:]]
    assert heads == [("TE", "mm"), ("EDP", "%"), ("TE", "÷ floor"), ("EDP", "÷ floor")]


def test_the_unit_of_a_metric_stands_where_all_rows_share_it():
    row = {"metric": "te_mm", "value": 1.0}
    both = [row, {"metric": "edp_percent", "value": 2.0}]
    units = [Table("t", rows, ("value",)).lay_out().columns[0].unit for rows in ([row], both)]
    assert units == ["mm", ""]


def test_tables_below_each_other_repeat_neither_cells_nor_sentences():
    columns = tuple(TableColumn(label) for label in ("Tissue", "Layers", "TE"))
    one, other = (("gel", "1", "0.08"),), (("gel", "all", "0.08"),)
    notes = ("Mean over insertions. Floor: noise.", "Floor: noise. After alignment.")
    tables = [
        TableLayout("t", "", columns, rows, notes=notes) for rows in (one, other, (("gel", "1", "0.09"),))
    ]
    shown = list(drop_repeated(tables))
    assert [table.rows[0][2] for table in shown] == ["0.08", "0.09"]
    assert [len(table.notes) for table in shown] == [2, 0]
