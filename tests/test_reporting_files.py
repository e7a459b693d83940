"""Files: whole or not there, the same bytes every time, synthetic data called so."""

import dataclasses
import json
import re
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest
from reporting_results import stereo, study

from needlefit.errors import ConfigError
from needlefit.metrics import METRICS, Metric
from needlefit.studies.fit_frames import COLUMNS
from needlefit.studies.fit_tables import format_macros
from needlefit.studies.kinds.cross_validation.report import format_methods, format_references
from needlefit.studies.paper_folder import write_paper_folder
from needlefit.studies.report import rebuild, write_run

FIGURES = ("boxplot", "insertions", "overlays", "waterfall")
EXPECTED = {
    *(f"{name}.csv" for name in ("design", "directions", "errors", "failures", "shapes", "starts")),
    *(f"{name}.csv" for name in ("checks", "validation", "tuning", "parameters")),
    *(f"{name}.tex" for name in ("validation", "tuning_by_layers", "tuning_by_media", "parameters")),
    *(f"{name}.tex" for name in ("summary", "baselines", "insertions", "directions", "design")),
    *(f"{name}.{kind}" for name in FIGURES for kind in ("pdf", "csv")),
    *(
        "numbers.tex",
        "report.pdf",
        "report.html",
        "results.json.gz",
        "run.json",
        "timing.json",
        "needlefit.json",
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("reports") / "study1"
    write_run(study(1), folder)
    return folder


def test_a_result_folder_holds_every_file(folder):
    assert {path.name for path in folder.iterdir()} == EXPECTED
    assert {path.name for path in write_run(study(1), folder, True).iterdir()} == EXPECTED
    assert [p.name for p in folder.parent.iterdir()] == ["study1"]
    for name in EXPECTED:
        assert (folder / name).stat().st_size > 0
        if name.endswith(".pdf"):
            assert (folder / name).read_bytes().startswith(b"%PDF")


def test_a_metric_that_was_added_since_has_no_value_in_a_stored_result(folder, tmp_path, monkeypatch):
    added = Metric("new_mm", "New", "mm", "A metric of a later version.", compute=lambda curves: 1.0)
    monkeypatch.setattr(METRICS, "_builtin_names", (*METRICS.names(), "new_mm"))
    monkeypatch.setitem(METRICS._builtin, "new_mm", added)
    shutil.copytree(folder, tmp_path / "study1")
    one = rebuild(tmp_path / "study1", tmp_path / "again")
    rows = pd.read_csv(tmp_path / "again/validation.csv")
    assert rows.loc[rows["metric"] == "new_mm", "value"].isna().all() and len(one.verdicts) == 4
    assert rows.loc[rows["metric"] == "te_mm", "value"].notna().any()


def test_every_table_is_marked_synthetic(folder):
    assert json.loads((folder / "timing.json").read_text()) == {"out": "somewhere", "seconds": 12.5}
    for path in folder.glob("*.tex"):
        assert path.read_text().count(r"\caption{SYNTHETIC DATA.") == path.read_text().count(r"\caption{")


def test_a_run_that_was_stopped_before_its_first_start_can_be_written(tmp_path):
    names = ("errors", "shapes", "parameters", "directions", "starts")
    nothing = {name: pd.DataFrame(columns=list(COLUMNS[name])) for name in names}
    files = write_run(study(1).with_frames(**nothing), tmp_path / "stopped")
    assert "report.pdf" in {path.name for path in files.iterdir()}
    assert "validation.csv" not in {path.name for path in files.iterdir()}


RECIPE = {
    "minimize": "posterior", "algorithm": "leastsquares", "starts": 16, "metric": True,
    "likelihood": {"noise": "correlated", "depths": "linear", "noise_scale": 1.0},
    "sample": {"ensembles": 4, "walkers": 16},
}  # fmt: skip
FREE, FIXED = {"bounds": [1, 2], "fixed": None}, {"bounds": None, "fixed": 1.0}
RUN = {
    "recipe": RECIPE,
    "rules": {"law": "ogden", "constraint_spacing_mm": 1.0, "thickness_mm": 40.0, "element_mm": 0.5},
    "versions": {"needlefit": "9.8.7", "python": "3.11.7", "numpy": "2.4.6", "nlopt": "2.11.0"},
    "medium": {"parameters": {"mu1_pa": FREE, "alpha1": FIXED, "bevel_mm": FREE}},
    "folds": [{"tune": ["a", "b"], "validate": ["c", "d", "e"]}],
    "dataset": {"measurement": {"operator": "none", "description": "points"}, "boundary_shared_sd_mm": []},
}


def run_of(**changed):
    one, run = study(1), RUN | changed
    starts = one.frames["starts"].assign(minimized=run["recipe"]["minimize"])
    return dataclasses.replace(one.with_frames(starts=starts), run=run)


def test_citations_and_entries_correspond():
    one = run_of()
    cited = {
        key for keys in re.findall(r"\\cite\{([^}]*)\}", format_methods(one)[0]) for key in keys.split(",")
    }
    assert "url" in format_references(format_methods(one)[1]).partition("\n")[0]
    entries = set(re.findall(r"^@\w+\{([^,]+),", format_references(format_methods(one)[1]), re.M))
    assert cited == entries and {"wang-bevel-tip", "nlopt"} <= cited and "emcee" not in cited


@pytest.mark.parametrize("results", [study(5), stereo()], ids=["study5", "stereo"])
def test_a_macro_holds_what_the_table_prints(results):
    text = format_macros([results])
    lines = re.findall(r"^\\nf(?:num|range|text)\{([^}]*)\}\{(.*)\}$", text, re.M)
    defined = dict(lines)
    assert len(defined) == len(lines) > 30  # no key twice
    bevel = next(words for key, words in defined.items() if key.endswith("-bevel"))
    row = results.frames["parameters"].query("method == 'fitted' and parameter == 'bevel_mm'").iloc[0]
    assert float(bevel) == pytest.approx(row["median"], rel=5e-3)
    assert all(re.fullmatch(r"[\w.-]+", key) for key in defined)


def test_moduli_are_in_the_unit_of_the_tables():
    results = study(5)
    parameters = results.frames["parameters"]
    chosen = (parameters["parameter"] == "mu1_pa") & (parameters["method"] == "fitted")
    row = {"value": 2.4e5, "median": 2.5e5, "determined": "yes", "status": "free"}
    row |= {"interval_low": 1e5, "interval_high": 4e6}
    for name, value in row.items():
        parameters = parameters.assign(**{name: parameters[name].astype(object).mask(chosen, value)})
    text = format_macros([results.with_frames(parameters=parameters)])
    found = dict(re.findall(r"^\\nf(?:num|text)\{[^}]*-(mu1[a-z-]*)\}\{(.*)\}$", text, re.M))
    wanted = {"mu1": "0.25", "mu1-unit": "MPa", "mu1-low": "0.1", "mu1-high": "4"}
    assert {key: words for key, words in found.items() if key in wanted} == wanted


@pytest.fixture
def written(tmp_path):
    """The paths of a run's folder and of a paper's folder made from it."""
    folder = write_run(run_of(), tmp_path / "study1")
    write_paper_folder(run_of(), folder, tmp_path / "paper")
    return folder, tmp_path / "paper"


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="LaTeX is not installed")
@pytest.mark.sweep
def test_the_latex_files_compile(written):
    head = (
        r"\documentclass[journal]{IEEEtran}\usepackage[T1]{fontenc}\usepackage{textcomp,booktabs,siunitx,url}"
    )
    words = ("pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex")
    for folder in written:
        names = sorted(path.stem for path in folder.glob("*.tex") if path.name != "numbers.tex")
        body = "\n".join(rf"\input{{{name}}}" for name in names)
        text = f"{head}\\input{{numbers}}\n\\begin{{document}}\n{body}\n\\end{{document}}\n"
        (folder / "all.tex").write_text(text)
        subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL)


@pytest.mark.sweep
def test_a_paper_has_every_figure_in_both_widths_with_letters_of_8_points(written):
    run, paper = written
    names = {path.stem for path in run.glob("*.pdf")} - {"report"}
    widths = {"single": 3.5, "double": 7.16}
    assert {path.stem for path in paper.glob("*.pdf")} == {f"{n}-{word}" for n in names for word in widths}
    for path in paper.glob("*.pdf"):
        width = float(re.search(rb"/MediaBox *\[ *0 +0 +([\d.]+)", path.read_bytes())[1]) / 72
        assert width == pytest.approx(widths[path.stem.rpartition("-")[2]], abs=0.01)
    with pytest.raises(ConfigError, match="not empty"):
        write_paper_folder(run_of(), run, paper)
