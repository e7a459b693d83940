"""`needlefit diff`: two runs are joined on the columns that name a row."""

import json

import numpy as np
import pandas as pd
import pytest
from test_cli import run

from needlefit.errors import DataError
from needlefit.project.folders import write_manifest
from needlefit.studies.run_differences import compare_runs, lay_out_differences

ERRORS = pd.DataFrame(
    {
        "fold": "all", "role": "validate", "method": "fitted", "boundaries": "measured",
        "insertion": ["a", "b", "c", "d"], "te_mm": [0.2, 0.4, np.nan, 0.8], "converged": True,
    }
)  # fmt: skip
PARAMETERS = pd.DataFrame({"parameter": ["mu1_pa", "bevel_mm"], "value": [1e5, 0.1], "determined": "yes"})
RUN = {"kind": "fit", "dataset": {"sha256": "abc"}, "recipe": {"seed": 1, "starts": 8}, "interrupted": False}


def write(folder, errors=ERRORS, parameters=PARAMETERS, **run_changes):
    folder.mkdir(parents=True)
    errors.to_csv(folder / "errors.csv", index=False)
    parameters.to_csv(folder / "parameters.csv", index=False)
    (folder / "run.json").write_text(json.dumps(RUN | run_changes))
    write_manifest(folder)
    return folder


@pytest.fixture
def first(tmp_path):
    return write(tmp_path / "a")


def find_values(found):
    return [(one.table, one.column, one.row, one.before, one.after, one.rows) for one in found]


def test_inputs_and_states_are_compared_by_their_path(first, tmp_path):
    assert compare_runs(first, write(tmp_path / "same")) == []
    other = write(tmp_path / "b", recipe={"seed": 2, "starts": 8}, interrupted=True)
    assert find_values(compare_runs(first, other)) == [
        ("run.json", "recipe.seed", "", 1, 2, 1),
        ("run.json", "interrupted", "", False, True, 1),
    ]


def test_of_a_column_the_greatest_change_is_given_whatever_the_order_of_rows(first, tmp_path):
    changed = ERRORS.assign(te_mm=[0.21, 0.4, np.nan, 0.7]).iloc[::-1]
    (one,) = compare_runs(first, write(tmp_path / "b", errors=changed))
    row = "all, validate, fitted, measured, d"
    assert find_values([one]) == [("errors.csv", "te_mm", row, 0.8, 0.7, 2)]
    assert one.change == pytest.approx(0.1)
    (one,) = compare_runs(first, write(tmp_path / "c", errors=ERRORS.assign(te_mm=[0.2, 0.4, 0.6, 0.8])))
    assert (one.before, one.after, one.change) == (None, 0.6, None)


def test_numbers_of_each_parameter_have_their_own_unit(first, tmp_path):
    moved = PARAMETERS.assign(value=[1.1e5, 0.2], determined=["yes", "no"])
    found = compare_runs(first, write(tmp_path / "b", parameters=moved))
    assert find_values(found) == [
        ("parameters.csv", "value", "bevel_mm", 0.1, 0.2, 1),
        ("parameters.csv", "value", "mu1_pa", 1e5, 1.1e5, 1),
        ("parameters.csv", "determined", "bevel_mm", "yes", "no", 1),
    ]


def test_rows_and_columns_of_one_run_only_are_listed(first, tmp_path):
    fewer = ERRORS.iloc[:3].drop(columns="converged")
    found = compare_runs(first, write(tmp_path / "b", errors=fewer))
    assert find_values(found) == [
        ("errors.csv", "rows", "all, validate, fitted, measured, d", 4, 3, 1),
        ("errors.csv", "converged", "", "converged", None, 1),
    ]


def test_rows_that_no_key_tells_apart_are_paired_in_their_order(tmp_path):
    tables = (pd.DataFrame({"x_mm": [1.0, end]}) for end in (2.0, 2.5))
    one, two = (write(tmp_path / str(n), parameters=table) for n, table in enumerate(tables))
    (found,) = compare_runs(one, two)
    assert (found.before, found.after, found.row) == (2.0, 2.5, "")


def test_runs_of_different_kinds_are_not_compared(first, tmp_path):
    with pytest.raises(DataError) as fault:
        compare_runs(first, write(tmp_path / "b", kind="calibration"))
    assert fault.value.exit_code == 3


def test_the_command_prints_a_row_for_each_difference(first, tmp_path, capsys):
    second = write(tmp_path / "b", errors=ERRORS.assign(te_mm=ERRORS["te_mm"] + 0.1), recipe={"seed": 2})
    found = compare_runs(first, second)
    assert len(lay_out_differences(found).rows) == len(found) == 3
    assert run("diff", str(first), str(second)) == 0
    capsys.readouterr()
    assert run("diff", str(first), str(second), "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["column"], row["rows"]) for row in rows] == [
        ("recipe.seed", 1), ("recipe.starts", 1), ("te_mm", 3),
    ]  # fmt: skip
