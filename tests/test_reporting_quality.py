"""What a reconstruction leaves behind: its page, its curves and bodies in Slicer, its tables."""

import numpy as np
import pandas as pd
import pytest
import reconstruction_cases as cases
from numpy.testing import assert_allclose

from needlefit.datasets.formats.mrk_json import read_mrk_json
from needlefit.geometry.curves import arc_length
from needlefit.studies.kinds.reconstruction import KIND
from needlefit.studies.kinds.reconstruction.report import tabulate_batch
from needlefit.studies.report import write_files
from needlefit.studies.slicer import write_scan

ENTRY, TIP = np.array([11.0, 11.0, 12.0]), np.array([11.0, 14.0, 40.0])  # LPS of the rendered needle


# the page


# Slicer


def test_slicer_gets_the_needle_where_it_lies_in_the_scan(tmp_path):
    one = cases.small()
    files = write_scan(one, tmp_path / "slicer", 1.27)
    lists = {markups.name.removeprefix("phantom1-03 "): markups for markups in read_mrk_json(files[0])}
    assert [*lists] == [
        f"{name} (synthetic)"
        for name in (
            *("whole needle", "inserted", "95 % band, low", "95 % band, high"),
            *("entry and tip", "layer crossings", "markers"),
        )
    ]
    inserted, low, high = (
        lists[f"{name} (synthetic)"].points for name in ("inserted", "95 % band, low", "95 % band, high")
    )
    assert_allclose(inserted[[0, -1]], [ENTRY, TIP], atol=0.15)
    assert arc_length(inserted)[-1] == pytest.approx(one.depth, rel=1e-4)
    assert_allclose(np.linalg.norm(high - low, axis=1), 2 * 1.96 * one.sd)
    assert_allclose((high - low)[-1] / np.linalg.norm((high - low)[-1]), [0, 1, 0], atol=0.02)
    assert lists["inserted (synthetic)"].labels[0] == "entry"
    assert lists["whole needle (synthetic)"].labels[0] == "base"
    assert lists["entry and tip (synthetic)"].labels == ("entry", "tip")
    crossing = lists["layer crossings (synthetic)"]
    assert crossing.labels == ("into layer 2, 14.0 mm",)
    assert crossing.points[0, 2] == pytest.approx(26.0, abs=0.1)
    markers = lists["markers (synthetic)"]
    assert markers.labels == tuple(f"marker {n}" for n in range(5))
    assert_allclose(markers.points, cases.MARKERS[:-1], atol=0.4)


# tables


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
