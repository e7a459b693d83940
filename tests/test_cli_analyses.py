"""An analysis of a design alone: `tune --design`."""

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from test_cli import run

from needlefit.studies import load


@pytest.mark.sweep
@pytest.mark.usefixtures("blank_figures")
def test_the_design_part_uses_no_measured_shape(tmp_path, monkeypatch):
    """Bent by 5 mm, the measured centreline changes a design by the places of its points alone."""
    monkeypatch.chdir(tmp_path)
    plain, tables = load.read, []

    def bend(path):
        found = plain(path)
        moved = [
            replace(i, points=i.points + [0.0, 5.0, 0.0] * (i.points / i.depth) ** 2 + [0.0, 0.0, 1.0])
            for i in found.insertions
        ]
        return replace(found, insertions=tuple(moved))

    for read in (plain, bend):
        monkeypatch.setattr(load, "read", read)
        assert run("tune study2 --design --jobs 1 -q") == 0
        tables.append(pd.read_csv(Path("reports/study2-design/identify.csv")))
    pd.testing.assert_frame_equal(*tables, rtol=0.05)
