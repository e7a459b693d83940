"""Commands of single analyses: `tune --design`, `view`."""

import json
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pandas as pd
import pytest
from page_files import read_page_data
from test_cli import run
from test_viewer_recording import recorded

from needlefit.planning.recording import read_recording
from needlefit.studies import load
from needlefit.viewer.opening import open_recording


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path / "reports" / "study2-design"


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """The folder of a run from the design alone, and what it printed."""
    with pytest.MonkeyPatch.context() as here, redirect_stdout(StringIO()) as printed:
        here.chdir(tmp_path_factory.mktemp("designed"))
        assert run("tune study2 --design --jobs 1 -q --explain") == 0
        return Path.cwd() / "reports" / "study2-design", printed.getvalue()


@pytest.mark.sweep
def test_the_design_part_ranks_the_parameters_of_one_short_insertion(designed):
    folder, out = designed
    assert "study2" in out
    table = pd.read_csv(folder / "identify.csv").set_index("parameter")
    assert "yes" not in set(table["determined"])
    profiles = pd.read_csv(folder / "profiles.csv")
    assert (profiles.groupby("parameter")["deviance"].min() == 0).all()
    assert (table.loc["bevel_mm", "end_low"], table.loc["bevel_mm", "end_high"]) == ("closed", "closed")
    assert table.loc["bevel_spread", "sd_ratio"] == pytest.approx(1.0)
    assert json.loads((folder / "run.json").read_text())["values"]["mu1_pa"] == pytest.approx(5e4)


@pytest.mark.sweep
@pytest.mark.usefixtures("blank_figures")
def test_the_design_part_uses_no_measured_shape(monkeypatch, designed, folder):
    """Bent by 5 mm, the measured centreline changes a design by the places of its points alone."""
    plain = load.read

    def bent(path):
        found = plain(path)
        moved = [
            replace(i, points=i.points + [0.0, 5.0, 0.0] * (i.points / i.depth) ** 2 + [0.0, 0.0, 1.0])
            for i in found.insertions
        ]
        return replace(found, insertions=tuple(moved))

    monkeypatch.setattr(load, "read", bent)
    assert run("tune study2 --design -q") == 0
    tables = [pd.read_csv(path / "identify.csv") for path in (folder, designed[0])]
    pd.testing.assert_frame_equal(*tables, rtol=0.05)


def test_view_writes_a_page_and_prints_its_path(tmp_path, capsys):
    assert run("view study2 --no-browser --out", tmp_path) == 0
    (printed,) = capsys.readouterr().out.splitlines()
    page = tmp_path / "view" / "study2.html"
    assert Path(printed) == page
    (needle,) = read_page_data(page.read_text("utf-8"))["needles"]
    assert needle["scene"]["measured"] is None and needle["tip"] != 0


def test_a_recording_opens_with_the_files_beside_it(tmp_path):
    path = tmp_path / "log.csv"
    recorded(path)
    shown = open_recording(read_recording(path))
    assert (shown.name, shown.first_cell) == ("study2", 1.0)
    path.write_text(path.read_text().replace('target = "study2"', 'target = "twin/phantom2-05"'))
    changed = open_recording(read_recording(path))
    assert changed.measured is None and changed.note != shown.note
