"""`needlefit diff`: two runs are joined on the columns that name a row."""

import numpy as np
import pytest
from made_again import store
from reporting_results import study, with_frames

from needlefit.errors import DataError
from needlefit.project.folders import write_manifest
from needlefit.reporting.table_files import write_json
from needlefit.studies.run_differences import compare_runs

RUN = study(1)
ERRORS = RUN.frames["errors"]


def write(folder, changed=RUN, **frames):
    folder.mkdir(parents=True)
    store(with_frames(changed, **frames), folder)
    write_json(folder / "run.json", changed.run_json)
    write_manifest(folder)
    return folder


@pytest.fixture
def first(tmp_path):
    return write(tmp_path / "a")


def of_table(found, name):
    return found[found["table"] == f"{name}.csv"]


def test_inputs_and_states_are_compared_by_their_path(first, tmp_path):
    assert compare_runs(first, write(tmp_path / "same")).empty
    other = RUN.with_metadata(recipe=RUN.metadata.recipe.model_copy(update={"starts": 99}))
    (one,) = compare_runs(first, write(tmp_path / "b", other)).to_dict("records")
    assert (one["table"], one["column"], one["after"]) == ("run.json", "recipe.starts", 99)


def test_of_a_column_the_greatest_change_is_given_whatever_the_order_of_rows(first, tmp_path):
    changed = ERRORS["te_mm"].copy()
    rows = np.flatnonzero(changed.notna())[[0, -1]]
    changed.iloc[rows] += [0.01, -0.1]
    found = compare_runs(first, write(tmp_path / "b", errors=ERRORS.assign(te_mm=changed).iloc[::-1]))
    (one,) = of_table(found, "errors").to_dict("records")
    assert (one["column"], one["rows"]) == ("te_mm", 2)
    assert one["change"] == pytest.approx(0.1)
    assert one["after"] == pytest.approx(one["before"] - 0.1)
    assert str(ERRORS["insertion"].iloc[rows[1]]) in one["row"]


def test_rows_and_columns_of_one_run_only_are_listed(first, tmp_path):
    kept = RUN.frames["starts"]
    fewer = kept.iloc[:-1].assign(more=1.0)
    found = of_table(compare_runs(first, write(tmp_path / "b", starts=fewer)), "starts")
    more = found[found["column"] == "more"]
    assert more[["before", "after", "rows"]].to_numpy().tolist() == [[None, 1.0, len(kept) - 1]]
    missing = found[found["column"] != "more"]
    assert len(missing) and missing["after"].isna().all() and set(missing["rows"]) == {1}


def test_runs_of_different_kinds_are_not_compared(first, tmp_path, world):
    with pytest.raises(DataError):
        compare_runs(first, world.find("identification"))
