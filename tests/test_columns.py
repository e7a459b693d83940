"""The registry of columns: every column of every CSV stands in it, once, with an explanation of its own."""

import re
from pathlib import Path

import pandas as pd
import pytest

from needlefit.reporting.columns import (
    FORMATS,
    LENGTH_ERROR_FORMAT,
    METRIC_FORMAT,
    Column,
    find_column,
    list_columns,
)
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.tidy import to_tidy
from needlefit.studies.kind import KINDS

REFERENCE = Path(__file__).parent.parent / "reports/reference"


def test_columns_have_explanations_of_their_own():
    columns = list_columns()
    explanations = [one.explanation for one in columns.values()]
    assert all(explanations) and len(set(explanations)) == len(explanations)
    formats = {
        form for one in columns.values() for form in re.findall(r":(\w+)}", one.format) or [one.format]
    }
    assert formats <= {*FORMATS, METRIC_FORMAT, LENGTH_ERROR_FORMAT}


@pytest.mark.parametrize("name", KINDS.names())
def test_every_column_that_a_kind_declares_is_registered(name):
    for frame, columns in KINDS[name].frames.items():
        written = to_tidy(pd.DataFrame(columns=list(dict.fromkeys(columns))))
        unknown = [one for one in written if not find_column(str(one)).explanation]
        assert not unknown, f"{frame}: {unknown}"


def test_every_column_of_the_committed_tables_is_registered():
    if not REFERENCE.is_dir():
        pytest.skip("not run from the repository")
    tables = [pd.read_csv(path) for path in REFERENCE.glob("*/*.csv")]
    names = {str(name) for table in tables for name in table}
    assert all(find_column(name).explanation for name in names)
    assert all(to_tidy(table) is table for table in tables)


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


def test_a_number_in_a_key_stands_in_the_heading():
    assert [find_column(key).label for key in ("p2.5", "q05", "alpha3")] == ["2.5 %", "5 %", "α3"]
    assert (find_column("tip_in_95").label, find_column("tip_in_95").unit) == ("Tip coverage", "95 %")


def test_pivoted_rows_have_a_column_for_each_place():
    names = ("study", "metric", "value", "over_floor")
    values = (("a", "te_mm", 1.0, 2.0), ("a", "edp_percent", 30.0, 4.0), ("b", "te_mm", 2.0, None))
    rows = pivot([dict(zip(names, one, strict=True)) for one in values], ["study"], ["metric"])
    places = ("te_mm", "edp_percent")
    columns = ("study", *(part(key, metric=name) for key in ("value", "over_floor") for name in places))
    table = Table("t", "", rows, columns).lay_out()
    assert table.rows == (("a", "1.00", "30.0", "2.0", "4.0"), ("b", "2.00", "–", "–", "–"))
    heads = [(one.label, one.unit) for one in table.columns[1:]]
    assert heads == [("TE", "mm"), ("EDP", "%"), ("TE", "÷ floor"), ("EDP", "÷ floor")]


def test_the_unit_of_a_metric_stands_where_all_rows_share_it():
    row = {"metric": "te_mm", "value": 1.0}
    both = [row, {"metric": "edp_percent", "value": 2.0}]
    units = [Table("t", "", rows, ("value",)).lay_out().columns[0].unit for rows in ([row], both)]
    assert units == ["mm", ""]
