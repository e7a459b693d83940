"""The prior of a layer from a compression test: `studies/compression_prior.py`, and what fits read."""

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pytest import approx

import needlefit
from needlefit.project.locate import find_file, shipped_folder
from needlefit.project.toml import load
from needlefit.schemas.medium import MaterialRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.identity import describe_configuration
from needlefit.studies.job import Settings
from needlefit.studies.load import load_study

SCRIPT = shipped_folder() / "studies" / "compression_prior.py"
FUNCTIONS = runpy.run_path(str(SCRIPT))


def load_specimen(alpha, low, noise, seed=1, kind="nominal"):
    """Return stretch and stress (kPa, negative) of a loading to `low`; noise: part of the largest stress."""
    x = np.linspace(1.0, low, 60)
    y = needlefit.compute_stress(12.0, alpha, x, kind)
    return x, y + noise * np.max(np.abs(y)) * np.random.default_rng(seed).normal(size=len(x))


def write_test(path):
    """Write three specimens, stresses positive in compression, each with an unloading after it."""
    parts = []
    for number, alpha in enumerate((-4.0, -5.0, -4.5)):
        x, y = load_specimen(alpha, 0.8, 0.002, number)
        rows = pd.DataFrame({"sample": f"gel{number}", "stretch": x, "nominal_stress_kpa": -y})
        parts += [rows, rows[::-1].assign(nominal_stress_kpa=0.0)[1:]]
    pd.concat(parts).to_csv(path, index=False)


@pytest.mark.parametrize("alpha", [-20.0, -4.7, 0.3, 9.0])
@pytest.mark.parametrize("kind", ["nominal", "true"])
def test_curves_give_back_their_mu_and_alpha(alpha, kind):
    found = FUNCTIONS["fit_specimen"]("gel", *load_specimen(alpha, 0.75, 1e-4, kind=kind), kind, 401)
    assert found["identified"] and found["alpha"] == approx(alpha, abs=4 * found["sd"])
    assert found["sd"] < 0.05 and found["mu_kpa"] == approx(12.0, rel=1e-3)


def test_a_curve_that_no_one_term_law_describes_does_not_fit():
    """Soft at first and stiff later, as a gel between rough plates; noise alone is no misfit."""
    x, y = load_specimen(-4.0, 0.8, 0.002)
    toe = y * (1 - np.exp(-(((1 - x) / 0.1) ** 2)))
    found = FUNCTIONS["fit_specimen"]("toe", x, toe, "nominal", 401)
    assert found["law"] == "does not fit" and not found["identified"]
    noisy = FUNCTIONS["fit_specimen"]("noisy", *load_specimen(-4.0, 0.8, 0.05), "nominal", 401)
    assert noisy["law"] == "fits"


def test_a_fit_takes_the_prior_and_its_run_holds_it(tmp_path, monkeypatch):
    write_test(tmp_path / "gel.csv")
    monkeypatch.chdir(tmp_path)
    words = (sys.executable, str(SCRIPT), "gel.csv", "--quick", "--foundation", "0.2", "5")
    out = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert "gel2" in out and Path("reports/compression_prior.png").stat().st_size > 1000
    prior = load(Path("reports/compression_prior.toml"), MaterialRecord)
    assert prior.alpha.mean == approx(-4.5, abs=0.05) and prior.alpha.sd == approx(1.3, abs=0.1)
    assert prior.mu_pa.median == approx(0.2 * 12e3, rel=0.01) and prior.mu_pa.factor > 5
    record = load(find_file("fit", "chicken"), FitRecord)
    priors = {"1": "reports/compression_prior.toml"}
    job = load_study("chicken", record.model_copy(update={"priors": priors}), Settings())
    assert job.parameters.prior.names == ("mu1_pa", "alpha1") and "alpha1" in job.parameters.bounds
    stated = describe_configuration(job).medium.parameters["alpha1"].prior
    assert stated.mean == prior.alpha.mean
