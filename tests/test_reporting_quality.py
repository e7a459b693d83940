"""The tables of a reconstruction."""

import numpy as np
import pandas as pd
import pytest
import reconstruction_cases as cases
from numpy.testing import assert_allclose

from needlefit.studies.kinds.reconstruction import KIND
from needlefit.studies.kinds.reconstruction.report import tabulate_batch
from needlefit.studies.report import write_files


def tabulate(*batch):
    record = KIND.make_record(scans=[one.scan.id for one in batch], recipe={"schema": 1})
    return tabulate_batch("batch", record, batch)


def test_tables_hold_every_scan_pair_and_crossing(tmp_path):
    batch = [cases.small(), cases.small(markers=False, layers=False)]
    write_files(tabulate(*batch), tmp_path)
    names = ("reconstruction", "markers", "crossings")
    scans, markers, crossings = (pd.read_csv(tmp_path / f"{name}.csv") for name in names)
    assert (len(scans), len(markers), len(crossings)) == (2, 5, 1)
    assert scans.loc[0, "markers_paired"] == 5 and np.isnan(scans.loc[1, "markers_paired"])
    assert scans["depth_mm"].to_numpy() == pytest.approx(28.22, abs=0.15)
    assert_allclose(
        markers["residual_mm"],
        np.linalg.norm(markers[[f"residual_{a}_mm" for a in "xyz"]], axis=1),
        rtol=1e-6,
    )
    rms = np.sqrt(np.mean(markers["residual_mm"] ** 2))
    assert scans.loc[0, "fre_mm"] == pytest.approx(rms, rel=1e-6)
    assert crossings.loc[0, ["out_of", "into"]].tolist() == [1, 2]
    assert (scans["origin"] == "synthetic").all()
