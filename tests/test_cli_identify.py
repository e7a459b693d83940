"""`needlefit identify`: what it prints and writes, from the design alone and after a fit."""

import json
import re
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from light_runs import blank_figures  # noqa: F401 - a fixture
from test_cli import run

from needlefit.inference.identifiability.identify import AGREEMENT
from needlefit.inference.identifiability.precision import KNOWN_BY_PRIOR
from needlefit.studies import job
from needlefit.studies.identification_tables import lay_out_identification
from needlefit.studies.kinds.identification import describe_design


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


@pytest.mark.sweep
def test_the_design_part_ranks_the_parameters_of_one_short_insertion(designed):
    folder, out = designed
    assert "1 insertion, 24 mm deep" in out and "study2" in out
    assert re.search(r"alpha1 .* 0\.001 mm .* 40 mm", " ".join(out.split()))
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


def test_a_parameter_that_needs_an_assumption_states_it_in_table_and_sentence():
    row = {
        "stage": "design", "fold": "all", "parameter": "mu3_pa", "status": "free", "determined": False,
        "note": "an assumption", "value": 2.2e5, "prior_sd": 3.0, "sd": 0.19, "sd_low": 0.19, "sd_high": 0.19,
        "fisher_sd": 0.19, "sd_ratio": 0.06, "low": 1.5e5, "high": 3.2e5, "end_low": "closed",
        "end_high": "closed", "tip_range_mm": None, "profile_verdict": "154 to 321 kPa (95 %)",
    }  # fmt: skip
    about = {"insertions": 1, "place": "here", "places_near": 3, "layers": "one", "depths_mm": [20.0, 30.0]}
    about |= {"medium": {"thickness_mm": 40.0}}
    for agreement, contrasted in ((AGREEMENT, False), ("the profile is 2 times wider below", True)):
        frame = pd.DataFrame([row | {"agreement": agreement}])
        found = SimpleNamespace(frames={"identify": frame, "directions": pd.DataFrame()}, run=about)
        sentence = describe_design(found)[1]
        assert "19 %" in sentence and "154 to 321 kPa" in sentence and "an assumption" in sentence
        assert (" but " in sentence) is contrasted
        assert "an assumption" in lay_out_identification(frame, expected=True).rows[0][-1]


@pytest.mark.sweep
def test_the_same_bytes_for_any_number_of_threads(designed, folder):
    assert run("identify", "study2", "--jobs", "2", "-q") == 0
    one, two = (
        {path.name: path.read_bytes() for path in place.iterdir() if path.name != "timing.json"}
        for place in (designed[0], folder)
    )
    assert one == two


@pytest.mark.sweep
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


@pytest.mark.sweep
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
