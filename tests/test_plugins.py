"""What an installed plugin adds appears in everything that a study prints and writes."""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from inference_cases import medium
from light_runs import predict_by_few_draws
from plugin_cases import EXAMPLE, VERSION, install, plugin_folder
from problem_cases import make_problem
from pytest import approx
from refusals import refusal
from reporting_results import skip_figures
from sampling_cases import Known, draw, flat, gaussian, weighted
from test_cli import run
from test_datasets import write_mine

from needlefit import plugins
from needlefit.datasets.read import read
from needlefit.errors import ConfigError
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.observations import make_observation
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.shape import compute_positions
from needlefit.metrics import Metric
from needlefit.plugins import PLUGINS_VARIABLE, use_plugins
from needlefit.registry import Registry


@pytest.fixture
def plugin(tmp_path_factory, monkeypatch):
    with plugin_folder(install(tmp_path_factory.mktemp("site")), monkeypatch):
        yield


def test_a_sampler_draws_from_a_density_of_known_moments(plugin):
    known = Known(gaussian(np.array([[1.0, 0.6], [0.6, 1.0]])))
    posterior = draw(known, weighted(known), sampler="random_walk", independent_draws=1000)
    assert posterior.sampler == "random_walk" and not posterior.faults
    assert np.cov(flat(posterior).T) == approx(np.array([[1.0, 0.6], [0.6, 1.0]]), abs=0.15)


@pytest.mark.sweep
def test_a_kind_of_study_is_run_reported_and_compared(tmp_path, plugin, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("studies").mkdir()
    Path("studies/deep.toml").write_text('schema = 2\nkind = "depth_study"\ndataset = "twin"\n')
    assert run("validate deep --json -q") == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["kind"], printed["origin"]) == ("depth_study", "synthetic")
    assert sum(row["insertions"] for row in printed["depths"]) == 47
    assert run("report deep --out reports/again -q") == 0
    for name in ("depths.csv", "depths.tex", "report.html", "report.pdf", "results.json.gz"):
        assert Path("reports/again", name).read_bytes() == Path("reports/deep", name).read_bytes()
    assert run("diff deep again") == 0


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

LAW_STUDY = """schema = 2
title = "Mine"
paper_study = 2
dataset = "mine"
medium = "soft"
recipe = "tiny"
tune = { insertions = ["example1"] }
validate = [{ insertions = ["example2"] }]
"""

RECIPE = """schema = 2
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


@pytest.fixture(params=["entry point", pytest.param("option", marks=pytest.mark.sweep)])
def law_site(request, tmp_path, monkeypatch):
    by_entry_point = request.param == "entry point"
    folder = install(tmp_path / "site", entry_point=by_entry_point)
    with plugin_folder(folder, monkeypatch):
        yield folder, () if by_entry_point else ("--plugins", EXAMPLE)


@pytest.fixture
def law_project(tmp_path, monkeypatch):
    """A project whose centrelines are `.xyz` files, and whose medium has the law of the plugin."""
    here = tmp_path / "work"
    for folder in ("configs/media", "configs/recipes", "studies", "data"):
        (here / folder).mkdir(parents=True)
    monkeypatch.chdir(here)
    dataset = write_mine(here / "data" / "mine")
    dataset.write_text(dataset.read_text().replace("{id}.csv", "{id}.xyz"))
    for table in (dataset.parent / "centerlines").glob("*.csv"):
        np.savetxt(table.with_suffix(".xyz"), pd.read_csv(table).to_numpy())
        table.unlink()
    (here / "configs/media/soft.toml").write_text(MEDIUM)
    (here / "configs/recipes/tiny.toml").write_text(RECIPE)
    (here / "studies/mine.toml").write_text(LAW_STUDY)
    return here


def test_a_study_with_everything_of_a_plugin(law_site, law_project, monkeypatch, capsys):
    _, options = law_site
    skip_figures(monkeypatch)
    predict_by_few_draws(monkeypatch)
    assert run("check mine", *options) == 0
    capsys.readouterr()
    assert run("validate mine --json -q", *options) == 0
    assert json.loads(capsys.readouterr().out)
    stored = json.loads((law_project / "reports/mine/run.json").read_text())
    version = stored["versions"][EXAMPLE]
    assert version == VERSION if not options else version.startswith("sha256:")
    assert stored["rules"]["law"] == "logarithmic"
    errors = pd.read_csv("reports/mine/errors.csv")
    assert errors[["end_error_mm", "floor_end_error_mm"]].gt(0).all(axis=None)
    assert set(errors.loc[errors["method"] == "parabola", "role"]) == {"tune", "validate"}
    for name in ("validation", "tuning"):
        rows = pd.read_csv(f"reports/mine/{name}.csv").query("metric == 'end_error_mm'")
        assert {"fitted", "straight", "parabola"} <= set(rows["method"])
        assert rows[["value", "floor"]].gt(0).all(axis=None) and rows["paper"].isna().all()
    assert run("report mine", *options) == 0
    assert {"logarithmic", "ogden"} < {*LAWS.names()}


def test_an_observation_is_one_file_of_a_plugin(tmp_path, plugin, monkeypatch):
    """A column of the table of insertions names it; points that it hides change no density."""
    monkeypatch.chdir(tmp_path)
    dataset = write_mine(tmp_path / "mine")
    table = pd.read_csv(dataset.parent / "insertions.csv")
    table.assign(observation="ultrasound").to_csv(dataset.parent / "insertions.csv", index=False)
    data = read(dataset)
    assert set(data.to_frame()["observation"]) == {"ultrasound"}
    one = data.insertions[0]
    seen = one.measure_arc("plane") > 10.0
    assert make_observation(data, one).rows == seen.sum() < len(seen)
    layers = max(len(each.sequence) for each in data.insertions)
    moved = one.with_points(one.points + np.outer(~seen, [0.0, 0.3, 0.0]))
    densities = []
    for insertion in (one, moved, replace(moved, observation="points")):
        asked = make_problem(data, [insertion], medium(layers))
        densities.append(asked.log_posterior((asked.lower + asked.upper) / 2))
    assert densities[1] == approx(densities[0], rel=1e-2)
    assert densities[2] < densities[0] - 1.0


TILT = """\
from dataclasses import dataclass

import numpy as np

from needlefit.inference.likelihood.nodes import make_nodes
from needlefit.inference.likelihood.observation import Observation, whiten
from needlefit.inference.likelihood.observations import ObservationType

BASE_MM = 5.0


@dataclass(frozen=True)
class Tilt(ObservationType):
    def observe_values(self, insertion, errors):
        tilt, sd = (insertion.observation_values[name] for name in ("tilt_rad", "tilt_sd_rad"))
        s = insertion.depth - np.array([BASE_MM, 0.0])
        cov = np.array([[sd**2]])
        whitening, log_norm = whiten(cov, np.empty((1, 0)))
        whitening = whitening @ np.array([[-1.0, 1.0]]) / BASE_MM
        measured = np.column_stack([s, [0.0, BASE_MM * tilt]])
        pose, nodes = errors.dataset.pose, make_nodes(insertion, s, "fixed", bevel=errors.bevels_vary)
        nothing, curves = np.empty((1, 0)), np.empty((0, 1))
        return Observation(measured, cov, nothing, nothing, whitening, log_norm, pose, nodes, curves)


TILT = Tilt("tilt")
"""


def test_an_observation_has_a_number_of_its_own(tmp_path, monkeypatch):
    """A tilt beside the points, stated to 1e-4 rad, decides their density."""
    dataset = write_mine(tmp_path / "mine")
    table = pd.read_csv(dataset.parent / "insertions.csv").filter(regex="^(?!observation)")
    table = table.assign(observation="tilt", observation_tilt_rad=0.05, observation_tilt_sd_rad=1e-4)
    table.to_csv(dataset.parent / "insertions.csv", index=False)
    with plugin_folder(install(tmp_path / "site", module="tilt", source=TILT), monkeypatch):
        data = read(dataset)
        one = data.insertions[0]
        assert one.observation_values == {"tilt_rad": 0.05, "tilt_sd_rad": 1e-4}
        record = medium(len(one.sequence))
        asked = make_problem(data, [one], record)
        at = (asked.lower + asked.upper) / 2
        shape = predict(asked.values(at), record, one)
        ends = compute_positions(shape, one.depth - np.array([5.0, 0.0]))[:, 1]
        misfits = asked.compute_misfits(at)
        assert np.abs(misfits).max() == approx(abs(np.diff(ends)[0] / 5.0 - 0.05) / 1e-4, rel=1e-3)


def test_the_name_of_a_metric_ends_in_its_unit():
    refusal(ConfigError, "tip_mm", Metric, "tip_mm", "", "deg", "", compute=lambda curves: 0.0)


@dataclass(frozen=True)
class Fruit:
    """An entry."""

    name: str


FRUIT = f"from {__name__} import Fruit\n"


@pytest.fixture
def fruits(tmp_path, monkeypatch):
    """A registry of a package with two entries, in a process without plugins."""
    package = tmp_path / "site" / "orchard"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "_tools.py").write_text("raise RuntimeError")
    (package / "apple.py").write_text(f"{FRUIT}APPLE = AGAIN = Fruit('apple')\n")
    (package / "pear.py").write_text(f"{FRUIT}PLUM = Fruit('plum')\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setenv(PLUGINS_VARIABLE, "")
    monkeypatch.setattr(plugins, "_loaded", None)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    before = set(sys.modules)
    yield Registry(Fruit, "orchard", "fruit")
    for name in set(sys.modules) - before:
        del sys.modules[name]


@pytest.mark.parametrize("name", ["apple", "fig"])
def test_a_name_that_exists_is_refused(fruits, tmp_path, name):
    for module in ("basket", "crate"):
        install(tmp_path / "site", module=module, source=f"{FRUIT}ONE = Fruit('{name}')\n")
    refused = refusal(ConfigError, "", fruits.names)
    assert ("orchard.apple" if name == "apple" else "basket") in refused.what
    assert ("basket" if name == "apple" else "crate") in refused.what


@pytest.mark.parametrize("place", ["work", "work/data/twin", "elsewhere/needles"])
@pytest.mark.parametrize("entry_point", [True, False])
def test_no_plugin_is_found_in_the_working_folder_or_among_data(
    fruits,
    tmp_path,
    monkeypatch,
    place,
    entry_point,
):
    marker = tmp_path / "it-ran"
    source = f"from pathlib import Path\nPath({str(marker)!r}).touch()\n"
    install(tmp_path / place, module="planted", entry_point=entry_point, source=source)
    if place != "work":
        (tmp_path / place / "dataset.toml").touch()
    monkeypatch.syspath_prepend(tmp_path / place)
    monkeypatch.syspath_prepend("")
    if entry_point:
        assert fruits.names() == ("apple", "pear")
    else:
        use_plugins(["planted"])
        refusal(ConfigError, "planted", fruits.names)
    assert not marker.exists()
    assert "" in sys.path
