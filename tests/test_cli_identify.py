"""`needlefit identify`: what it prints and writes, from the design alone and after a fit."""

import json
import re
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pandas as pd
import pytest
from light_runs import blank_figures  # noqa: F401 - a fixture
from made_again import assert_made_again
from test_cli import run

from needlefit.inference.identifiability.information import KNOWN_BY_PRIOR
from needlefit.studies import job

FILES = {
    *(
        "directions.csv",
        "directions.tex",
        "example.tex",
        "identification.tex",
        "identify.csv",
        "needlefit.json",
    ),
    *("numbers.tex", "profiles.csv", "profiles.pdf", "report.html", "report.pdf", "results.json.gz"),
    *("run.json", "timing.json"),
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path / "reports" / "identify-study2"


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """The folder of a run from the design alone, and what it printed."""
    with pytest.MonkeyPatch.context() as here, redirect_stdout(StringIO()) as printed:
        here.chdir(tmp_path_factory.mktemp("designed"))
        assert run("identify", "study2", "--jobs", "1", "-q", "--explain") == 0
        return Path.cwd() / "reports" / "identify-study2", printed.getvalue()


@pytest.mark.slow
def test_the_design_part_ranks_the_parameters_of_one_short_insertion(designed):
    folder, out = designed
    assert "1 insertion, 24 mm deep" in out and "study2" in out
    assert re.search(r"alpha1 .* 0\.001 mm .* 40 mm", " ".join(out.split()))
    assert {path.name for path in folder.iterdir()} == FILES
    table = pd.read_csv(folder / "identify.csv").set_index("parameter")
    assert set(table["stage"]) == {"design"} and not table["determined"].any()
    assert table.loc["alpha1", "sd_ratio"] == pytest.approx(1.0, abs=1e-3)
    assert (table.loc["bevel_mm", "end_low"], table.loc["bevel_mm", "end_high"]) == ("closed", "closed")
    assert (table["sd_low"] <= table["sd"])[:3].all() and (table["sd_high"] >= table["sd"])[:3].all()
    found = pd.read_csv(folder / "directions.csv").drop_duplicates("combination")
    assert (found["sd"].diff().dropna() > 0).all() and (found["sd_ratio"] <= 1).all()
    assert found.iloc[0]["sd"] < 0.15 and found.iloc[0]["sd_ratio"] < 0.15
    tied = found[found["combination"].str.contains(r"^mu1 \*.* mu3\^-1\b")].iloc[0]
    assert tied["sd"] < 0.15 and tied["sd_ratio"] > 0.9 and KNOWN_BY_PRIOR in tied["note"]
    sentences = out[out.index("Design alone") :]
    assert found.iloc[0]["combination"] in sentences and tied["combination"] not in sentences
    assert table.loc["bevel_spread", "sd_ratio"] == pytest.approx(1.0)
    assert json.loads((folder / "run.json").read_text())["values"]["mu1_pa"] == pytest.approx(5e4)


@pytest.mark.slow
def test_the_same_bytes_for_any_number_of_threads(designed, folder):
    assert run("identify", "study2", "--jobs", "2", "-q") == 0
    one, two = (
        {path.name: path.read_bytes() for path in place.iterdir() if path.name != "timing.json"}
        for place in (designed[0], folder)
    )
    assert one == two


@pytest.mark.slow
def test_a_fit_adds_its_stage_beside_the_design(folder, capsys):
    text = (
        'schema = 1\ndataset = "twin"\nmedium = "phantom2"\nrecipe = "quick"\n'
        '[tune]\nmedium = "phantom2"\nlayers = [1]\n'
    )
    (folder.parents[1] / "one.toml").write_text(text)
    assert run("identify", "./one.toml", "--fit", "--json", "-q") == 0
    output = json.loads(capsys.readouterr().out)
    assert {"design", "fit", "sentences", "directions", "place"} <= set(output)
    by_stage = pd.read_csv(folder.parent / "identify-one" / "identify.csv").groupby("stage")["parameter"]
    assert by_stage.size()["design"] == by_stage.size()["fit"]
    for name in ("profiles", "profiles_design"):
        profiles = pd.read_csv(folder.parent / "identify-one" / f"{name}.csv")
        assert (profiles.groupby("parameter")["deviance"].min() == 0).all()
    assert_made_again(folder.parent / "identify-one")


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_the_design_part_uses_no_measured_shape(monkeypatch, designed, folder):
    """Bent by 5 mm, the measured centreline changes nothing that the design says."""
    plain = job.read

    def bent(path):
        found = plain(path)
        moved = [
            replace(
                i, planar=i.planar + [0, 5.0] * (i.planar / i.depth) ** 2, out_of_plane=i.out_of_plane + 1
            )
            for i in found.insertions
        ]
        return replace(found, insertions=tuple(moved))

    monkeypatch.setattr(job, "read", bent)
    assert run("identify", "study2", "-q") == 0
    assert (folder / "identify.csv").read_bytes() == (designed[0] / "identify.csv").read_bytes()
