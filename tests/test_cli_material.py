"""`needlefit material`: what it prints and writes, and how a fit takes its prior."""

import hashlib
import json
import re
import tomllib
from pathlib import Path

import pytest
from compression_cases import gel_file
from light_runs import blank_figures  # noqa: F401 - a fixture
from test_cli import run

from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.medium import MaterialRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies import provenance
from needlefit.studies.job import Settings, prepare


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


@pytest.mark.sweep
@pytest.mark.usefixtures("blank_figures")
def test_the_same_file_gives_the_same_bytes(gel, tmp_path, capsys):
    sums = []
    for name in ("a", "b"):
        assert run("material", "gel.csv", "--out", name) == 0
        folder = tmp_path / name / "material-gel"
        sums.append({p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.iterdir()})
        del sums[-1]["timing.json"]
    assert sums[0] == sums[1]


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
    work = provenance.describe_configuration(job)
    assert work["medium"]["parameters"]["alpha1"]["prior"]["mean"] == stated["alpha"]["mean"]
    assert work["study"]["priors"] == {"1": "reports/material-gel/prior.toml"}
