import dataclasses
import gzip
import json

import numpy as np
import pandas as pd
import pytest
from made_again import store
from reporting_results import stereo, study
from test_reporting_posterior import sampled

from needlefit.errors import DataError
from needlefit.project.folders import write_manifest
from needlefit.reporting.table_files import write_json
from needlefit.studies.combined_report import rebuild, write_combined
from needlefit.studies.fit_frames import COLUMNS
from needlefit.studies.store import RESULTS_FILE, restore_run


@pytest.mark.parametrize("results", [study(1), study(5), stereo()], ids=["study1", "study5", "stereo"])
def test_stored_values_round_trip_to_the_last_digit(results, tmp_path):
    store(results, tmp_path)
    found = restore_run(tmp_path)
    for name in COLUMNS:
        pd.testing.assert_frame_equal(found.frames[name], results.frames[name], check_exact=True)
    assert found.record == results.record and type(found.record) is type(results.record)
    again = tmp_path / "again"
    again.mkdir()
    assert store(found, again).read_bytes() == (tmp_path / RESULTS_FILE).read_bytes()


def test_floats_that_are_no_numbers_and_cells_that_are_empty_survive(tmp_path):
    one = study(1)
    starts = one.frames["starts"].copy()
    starts.loc[0, "objective"] = np.inf
    starts.loc[1, "objective"] = np.nan
    starts["joined"] = [None, *range(len(starts) - 1)]
    store(one.with_frames(starts=starts), tmp_path)
    found = restore_run(tmp_path).frames["starts"]
    pd.testing.assert_frame_equal(found, starts, check_exact=True)
    assert found["joined"].dtype == starts["joined"].dtype


def test_a_folder_without_results_is_an_error_that_names_it(tmp_path):
    with pytest.raises(DataError, match="no stored results") as fault:
        restore_run(tmp_path)
    assert str(tmp_path) in fault.value.where


@pytest.mark.parametrize(
    "damage", [lambda b: b[: len(b) // 2], lambda b: b"{}", lambda b: gzip.compress(b"{}")]
)
def test_damaged_results_are_an_error(damage, tmp_path):
    path = store(study(1), tmp_path)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(DataError) as caught:
        restore_run(tmp_path)
    assert RESULTS_FILE in caught.value.where and caught.value.fix


def test_results_of_another_format_are_refused(tmp_path):
    path = store(study(1), tmp_path)
    content = json.loads(gzip.decompress(path.read_bytes()))
    other = gzip.compress(json.dumps(content | {"format": 99}).encode())
    path.write_bytes(other)
    with pytest.raises(DataError, match="format"):
        restore_run(tmp_path)
    assert path.read_bytes() == other


def test_a_posterior_is_read_from_the_file_beside(tmp_path):
    one = sampled(0.08, 0.09)
    (posterior,) = one.posteriors.values()
    store(one, tmp_path)
    (fold,) = restore_run(tmp_path).posteriors
    found = restore_run(tmp_path).posteriors[fold]
    assert fold in one.posteriors and found.names == posterior.names
    assert np.array_equal(found.draws, posterior.draws)


@pytest.mark.sweep
def test_a_joint_report_is_rebuilt_from_the_runs_beside_it(tmp_path):
    every = [dataclasses.replace(study(k), name=f"study{k}") for k in (1, 5)]
    for one in every:
        (tmp_path / one.name).mkdir()
        store(one, tmp_path / one.name)
        write_json(tmp_path / one.name / "run.json", one.run_json)
        write_manifest(tmp_path / one.name)
    write_combined(every, tmp_path / "all")
    rebuild(tmp_path / "all", tmp_path / "again")
    first, second = tmp_path / "all", tmp_path / "again"
    for path in first.iterdir():
        if path.name != "timing.json":
            assert (second / path.name).read_bytes() == path.read_bytes(), path.name
    write_json(tmp_path / "study5/run.json", {"seed": 2})
    write_manifest(tmp_path / "study5")
    with pytest.raises(DataError, match=r"study5.*`all`"):
        rebuild(first, second)
