"""Files: whole or not there, the same bytes every time, synthetic data called so."""

import json
import shutil

import pandas as pd
import pytest
from reporting_results import study, with_frames

from needlefit.metrics import METRICS, Metric
from needlefit.studies.kinds.cross_validation.rows import FRAMES
from needlefit.studies.report import rebuild, write_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports") / "study1"
    write_run(study(1), folder)
    return folder


def test_a_metric_that_was_added_since_has_no_value_in_a_stored_result(folder, tmp_path, monkeypatch):
    added = Metric("new_mm", "New", "mm", "A metric of a later version.", compute=lambda curves: 1.0)
    monkeypatch.setattr(METRICS, "_builtin_names", (*METRICS.names(), "new_mm"))
    monkeypatch.setitem(METRICS._builtin, "new_mm", added)
    shutil.copytree(folder, tmp_path / "study1")
    one = rebuild(tmp_path / "study1", tmp_path / "again")
    rows = pd.read_csv(tmp_path / "again/validation.csv")
    assert rows.loc[rows["metric"] == "new_mm", "value"].isna().all() and len(one.verdicts) == 1
    assert rows.loc[rows["metric"] == "te_mm", "value"].notna().any()


def test_every_table_is_marked_synthetic(folder):
    assert json.loads((folder / "timing.json").read_text()) == {"out": "somewhere", "seconds": 12.5}
    for path in folder.glob("*.tex"):
        assert path.read_text().count(r"\caption{SYNTHETIC data.") == path.read_text().count(r"\caption{")


def test_a_run_that_was_stopped_before_its_first_start_can_be_written(tmp_path):
    names = ("errors", "shapes", "parameters", "directions", "starts")
    nothing = {name: pd.DataFrame(columns=list(FRAMES[name])) for name in names}
    files = write_run(with_frames(study(1), **nothing), tmp_path / "stopped")
    assert "report.pdf" in {path.name for path in files.iterdir()}
    assert "validation.csv" not in {path.name for path in files.iterdir()}
