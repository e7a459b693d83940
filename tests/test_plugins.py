"""What an installed plugin adds appears in everything that a study prints and writes."""

import contextlib
import io
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from light_runs import draw_blank, predict_by_few_draws
from plugin_cases import EXAMPLE, VERSION, install, plugin_folder
from test_cli import run

from needlefit.project.locate import find_file

STUDY = """\
schema = 2
title = "Small"
dataset = "twin"
medium = "phantom2"
recipe = "small"
paper_study = 2
tune = { insertions = ["phantom2-16"] }
validate = [{ insertions = ["phantom2-15"] }]
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(tmp_path_factory.mktemp("site"))


@pytest.fixture
def plugin(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with plugin_folder(site, monkeypatch):
        yield


@pytest.fixture(scope="module")
def project(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder in which a small study was run with the plugin; what it printed is in `printed.json`."""
    folder = tmp_path_factory.mktemp("project")
    (folder / "studies").mkdir()
    (folder / "studies/small.toml").write_text(STUDY, encoding="utf-8")
    recipe = find_file("recipe", "quick").read_text(encoding="utf-8").replace("starts = 4", "starts = 1")
    (folder / "configs/recipes").mkdir(parents=True)
    (folder / "configs/recipes/small.toml").write_text(recipe, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch, plugin_folder(site, patch):
        patch.chdir(folder)
        draw_blank(patch)
        predict_by_few_draws(patch)
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            assert run("validate", "small", "--json", "-q") == 0
    (folder / "printed.json").write_text(printed.getvalue(), encoding="utf-8")
    yield folder


@pytest.fixture
def report(project: Path, plugin: None, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The result's folder, with the plugin in use."""
    monkeypatch.chdir(project)
    return project / "reports/small"


def select(rows: list[dict[str, Any]], **wanted: object) -> list[dict[str, Any]]:
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def test_a_metric_and_a_baseline_are_in_every_table(report: Path) -> None:
    errors = pd.read_csv(report / "errors.csv")
    assert errors[["end_error_mm", "floor_end_error_mm"]].gt(0).all(axis=None)
    assert set(errors.loc[errors["method"] == "parabola", "role"]) == {"tune", "validate"}
    for name in ("validation", "tuning"):
        rows = pd.read_csv(report / f"{name}.csv").query("metric == 'end_error_mm'")
        assert {"fitted", "straight", "parabola"} <= set(rows["method"])
        assert rows[["value", "pooled", "floor"]].gt(0).all(axis=None) and rows["paper"].isna().all()


@pytest.mark.sweep
def test_they_are_printed_typeset_and_drawn(report: Path) -> None:
    printed = json.loads((report.parents[1] / "printed.json").read_text(encoding="utf-8"))
    (row,) = select(printed["validation"], metric="end_error_mm", method="parabola")
    assert row["value"] > row["floor"] > 0 and row["paper"] is None
    numbers = (report / "numbers.tex").read_text(encoding="utf-8")
    assert "-end-error}{" in numbers and "-floor-end-error}{" in numbers
    assert "End error" in (report / "validation.tex").read_text(encoding="utf-8")
    page = (report / "report.html").read_text(encoding="utf-8")
    assert page.count("End error") >= 4 and "plain parabola" in page
    assert "parabola" in set(pd.read_csv(report / "errors.csv")["method"])
    assert json.loads((report / "run.json").read_text())["versions"][EXAMPLE] == VERSION


@pytest.mark.sweep
def test_they_are_made_again_and_compared(report: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("report", "small", "--out", "reports/again", "-q") == 0
    again = report.with_name("again")
    for name in ("errors.csv", "validation.csv", "numbers.tex"):
        assert (again / name).read_bytes() == (report / name).read_bytes()
    errors = pd.read_csv(again / "errors.csv")
    other = report.with_name("other")
    shutil.copytree(again, other)
    errors.assign(end_error_mm=errors["end_error_mm"] + 1).to_csv(other / "errors.csv", index=False)
    capsys.readouterr()
    assert run("diff", "small", "other", "--json") == 3  # its manifest lists another errors.csv
    assert run("diff", "small", "other", "--json", "--unverified") == 0
    found = select(json.loads(capsys.readouterr().out), what="error")
    assert any("End error" in one["where"] and "parabola" in one["where"] for one in found)


@pytest.mark.sweep
def test_a_kind_of_study_is_run_reported_and_compared(
    tmp_path: Path, plugin: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("studies").mkdir()
    Path("studies/deep.toml").write_text('schema = 2\nkind = "depth_study"\ndataset = "twin"\n')
    assert run("validate", "deep", "--json", "-q") == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["kind"], printed["origin"]) == ("depth_study", "synthetic")
    assert sum(row["insertions"] for row in printed["depths"]) == 47
    assert run("report", "deep", "--out", "reports/again", "-q") == 0
    for name in ("depths.csv", "depths.tex", "numbers.tex", "report.html", "report.pdf", "results.json.gz"):
        assert Path("reports/again", name).read_bytes() == Path("reports/deep", name).read_bytes()
    assert run("diff", "deep", "again") == 0


@pytest.mark.sweep
def test_without_the_plugin_the_stored_result_is_still_shown(project: Path) -> None:
    words = (sys.executable, "-m", "needlefit", "report", "small", "--out", "reports/plain", "-q")
    subprocess.run(words, cwd=project, check=True)  # its columns are declared nowhere: no check of tests
    page = (project / "reports/plain/report.html").read_text(encoding="utf-8")
    assert "End error" not in page
