"""A plugin's tissue law and file format, by an entry point and by --plugins, and where none is looked for."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from light_runs import predict_by_few_draws
from plugin_cases import EXAMPLE, VERSION, install, plugin_folder
from reporting_results import skip_figures
from test_cli import run

from needlefit.datasets.read import check
from needlefit.datasets.template import write_template
from needlefit.mechanics.laws import LAWS
from needlefit.registry import use_plugins
from needlefit.verification.checks.compiled import measure_law

MEDIUM = """schema = 1
layers = 2
law = "logarithmic"

[parameters]
mu1_pa = { bounds = [1e4, 1e6] }
alpha1 = { bounds = [0.0, 3.0] }
mu2_pa = { tie = "mu1_pa", spread = 1.0 }
alpha2 = { tie = "alpha1" }
bevel_mm = { bounds = [1e-3, 0.5] }
"""

STUDY = """schema = 2
title = "Mine"
dataset = "mine"
medium = "soft"
recipe = "tiny"
tune = { insertions = ["example1"] }
validate = [{ insertions = ["example2"] }]
"""

RECIPE = """schema = 2
algorithm = "leastsquares"
starts = 1
evaluations = 100
tolerance = 1e-2

[weights]
ipe = 1.0
te = 1.0
edp = 0.1
edp_floor_mm = 0.2

[likelihood]
bevel_spread = 0.0
"""

Site = tuple[Path, tuple[str, ...]]
"""The folder of the plugin, and the options that name it."""


@pytest.fixture(params=["entry point", "option"])
def site(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    by_entry_point = request.param == "entry point"
    folder = install(tmp_path / "site", entry_point=by_entry_point)
    with plugin_folder(folder, monkeypatch):
        yield folder, () if by_entry_point else ("--plugins", EXAMPLE)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project whose centrelines are `.xyz` files, and whose medium has the law of the plugin."""
    here = tmp_path / "work"
    for folder in ("configs/media", "configs/recipes", "studies", "data"):
        (here / folder).mkdir(parents=True)
    monkeypatch.chdir(here)
    dataset = write_template(here / "data" / "mine")
    dataset.write_text(dataset.read_text().replace("{id}.csv", "{id}.xyz"))
    for table in (dataset.parent / "centerlines").glob("*.csv"):
        np.savetxt(table.with_suffix(".xyz"), pd.read_csv(table).to_numpy())
        table.unlink()
    (here / "configs/media/soft.toml").write_text(MEDIUM)
    (here / "configs/recipes/tiny.toml").write_text(RECIPE)
    (here / "studies/mine.toml").write_text(STUDY)
    return here


def test_a_study_with_everything_of_a_plugin(
    site: Site, project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, options = site
    skip_figures(monkeypatch)
    predict_by_few_draws(monkeypatch)
    assert run("check", "mine", *options) == 0
    capsys.readouterr()
    assert run("validate", "mine", "--json", "-q", *options) == 0
    assert json.loads(capsys.readouterr().out)
    stored = json.loads((project / "reports/mine/run.json").read_text())
    version = stored["versions"][EXAMPLE]
    assert version == VERSION if not options else version.startswith("sha256:")
    assert stored["rules"]["law"] == "logarithmic"
    assert run("report", "mine", *options) == 0
    assert {"logarithmic", "ogden"} < {*LAWS.names()}


def test_curves_of_the_format_become_a_dataset(site: Site, project: Path) -> None:
    _, options = site
    assert run("new", "dataset", "other", "--from", "data/mine/centerlines/example1.xyz", *options) == 0
    assert check(Path("other")) == []


def test_the_law_is_verified(site: Site) -> None:
    _, options = site
    use_plugins(options[1:])
    found = measure_law("logarithmic", np.random.default_rng(1))
    assert max(found.values) < 1e-6


def test_without_the_plugin_law_and_format_are_unknown(project: Path) -> None:
    assert run("check", "mine") == 3
    assert run("tune", "mine") == 3


def test_a_module_of_the_working_folder_is_refused(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(project, entry_point=True)
    with plugin_folder(project, monkeypatch):
        assert run("check", "mine", "--plugins", EXAMPLE) == 3
        assert EXAMPLE in capsys.readouterr().err
