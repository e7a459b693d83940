"""Commands of single analyses: `tune --design`, `material`, `view`."""

import json
import re
import signal
import subprocess
import sys
import tomllib
import urllib.request
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pandas as pd
import pytest
from compression_cases import gel_file
from test_cli import run
from test_viewer_recording import recorded

from needlefit.inference.identifiability.directions import KNOWN_BY_PRIOR
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.medium import MaterialRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies import job
from needlefit.studies.job import Settings, prepare
from needlefit.studies.provenance import describe_configuration
from needlefit.viewer.opening import open_recording
from needlefit.viewer.recording import read_recording


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path / "reports" / "study2-design"


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    """The folder of a run from the design alone, and what it printed."""
    with pytest.MonkeyPatch.context() as here, redirect_stdout(StringIO()) as printed:
        here.chdir(tmp_path_factory.mktemp("designed"))
        assert run("tune", "study2", "--design", "--jobs", "1", "-q", "--explain") == 0
        return Path.cwd() / "reports" / "study2-design", printed.getvalue()


@pytest.mark.sweep
def test_the_design_part_ranks_the_parameters_of_one_short_insertion(designed):
    folder, out = designed
    assert "1 insertion, 24 mm deep" in out and "study2" in out
    assert re.search(r"alpha1 .* 0\.001 mm .* 40 mm", " ".join(out.split()))
    table = pd.read_csv(folder / "identify.csv").set_index("parameter")
    assert not table["determined"].any()
    profiles = pd.read_csv(folder / "profiles.csv")
    assert (profiles.groupby("parameter")["deviance"].min() == 0).all()
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
    assert run("tune", "study2", "--design", "-q") == 0
    assert (folder / "identify.csv").read_bytes() == (designed[0] / "identify.csv").read_bytes()


@pytest.fixture
def gel(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return gel_file(tmp_path / "gel.csv")


def test_estimates_of_the_specimens_are_printed_and_written(world):
    folder, out = world.find("material"), world.read_printed("material")
    assert "identified" in out and out.startswith("alpha = -4.") and " kPa ± " in out
    assert re.search(r'priors = .*"reports/material-gel/prior\.toml"', out.replace(f"{world.folder}/", ""))
    tested = load(folder / "prior.toml", MaterialRecord)
    assert tested.alpha.mean == pytest.approx(-4.5, abs=0.2) and tested.mu_pa is None
    assert "these 3" in tested.note
    about = json.loads((folder / "run.json").read_text())
    assert about["measure"] == "nominal" and about["sha256"] == tested.sha256


@pytest.mark.sweep
@pytest.mark.usefixtures("blank_figures")
def test_the_prior_of_the_foundation_modulus_is_written_on_request_alone(gel, capsys):
    assert run("material", "gel.csv", "--foundation", "0.2", "5", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    mu = found["prior"]["mu_pa"]
    assert mu["median"] == pytest.approx(0.2 * 12e3, rel=0.05) and mu["factor"] > 5
    assert found["specimens"][-1]["specimen"] == "(a further one)"


@pytest.mark.usefixtures("blank_figures")
def test_an_unidentified_parameter_writes_no_prior_and_prints_the_flat_range(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    gel_file(tmp_path / "shallow.csv", alphas=(3.0,), low=0.997)
    assert run("material", "shallow.csv", "--explain") == 0
    out = capsys.readouterr().out
    assert "alpha" in out and "0.997 to 1" in out
    assert not (tmp_path / "reports" / "material-shallow" / "prior.toml").exists()


def test_a_faulty_file_ends_in_exit_code_3(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.csv").write_text("strain,stress\n0,0\n")
    assert run("material", "bad.csv") == 3
    err = capsys.readouterr().err
    assert err.count("bad.csv:1") == 2 and "stretch" in err and "stress" in err
    assert run("material", "none.csv") == 3
    assert run("material", "bad.csv", "--foundation", "0.2", "0.5") == 3


@pytest.mark.sweep
@pytest.mark.usefixtures("blank_figures")
def test_a_fit_takes_the_prior_and_its_run_holds_it(gel, capsys):
    assert run("material", "gel.csv", "--foundation", "0.2", "5") == 0
    record = load(find_file("fit", "chicken"), FitRecord)
    with_prior = record.model_copy(update={"priors": {"1": "reports/material-gel/prior.toml"}})
    job = prepare("chicken", with_prior, Settings())
    assert job.parameters.prior.names == ("mu1_pa", "alpha1") and "alpha1" in job.parameters.bounds
    stated = tomllib.loads(Path("reports/material-gel/prior.toml").read_text())
    work = describe_configuration(job)
    assert work["medium"]["parameters"]["alpha1"]["prior"]["mean"] == stated["alpha"]["mean"]
    assert work["study"]["priors"] == {"1": "reports/material-gel/prior.toml"}


def test_view_serves_its_page_and_ends_on_a_signal(tmp_path):
    command = [sys.executable, "-m", "needlefit", "view", "study2", "--no-browser", "--out", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        address = process.stdout.readline()
        page, token = address.strip().split("#token=")
        with urllib.request.urlopen(page) as answer:
            text = answer.read().decode()
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=20)
    assert page.startswith("http://127.0.0.1:") and len(token) >= 32
    assert "<title>needlefit" in text and token not in text
    assert (process.returncode, out) == (0, "")  # nothing was steered, so nothing recorded
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (("no_such_thing",), 3, "no_such_thing"),
        (("twin/phantom2-99",), 3, "phantom2-09"),
        (("study2", "--recording", "log.csv"), 2, "leave it out"),
        (("--recording", "log.csv"), 3, "no such file"),
        (("study2", "--port", "70000"), 2, "--port"),
    ],
)
def test_invalid_input_is_refused_before_anything_is_served(words, code, expected, capsys, tmp_path):
    assert run("view", *words, "--no-browser", "--out", str(tmp_path)) == code
    assert expected in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_port_in_use_is_reported(capsys):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert run("view", "study2", "--no-browser", "--port", str(port)) == 3
    assert f"port {port} cannot be used" in capsys.readouterr().err


def test_a_missing_extra_is_named_with_its_install_command(capsys, monkeypatch):
    import needlefit.viewer.server

    # the import that fails makes a new package of this name; later tests need the attribute as it was
    monkeypatch.setattr(needlefit.viewer, "server", needlefit.viewer.server)
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    monkeypatch.delitem(sys.modules, "needlefit.viewer.server")
    assert run("view", "study2", "--no-browser") == 3
    assert "'needlefit[view]'" in capsys.readouterr().err


def test_a_recording_opens_with_the_files_beside_it(tmp_path):
    path = tmp_path / "log.csv"
    recorded(path)
    shown = open_recording(read_recording(path))
    assert (shown.name, shown.first_cell) == ("study2", 1.0)
    path.write_text(path.read_text().replace('target = "study2"', 'target = "twin/phantom2-05"'))
    changed = open_recording(read_recording(path))
    assert changed.measured is None and "has changed since" in changed.note
    path.write_text(path.read_text().replace('target = "twin/phantom2-05"', 'target = "gone"'))
    assert "is not found" in open_recording(read_recording(path)).note
