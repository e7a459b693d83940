"""Files: whole or not there, the same bytes every time, synthetic data called so."""

import json
import shutil
import subprocess

import pandas as pd
import pytest
from reporting_results import study

from needlefit.metrics import METRICS, Metric
from needlefit.studies.kinds.cross_validation.rows import FRAMES
from needlefit.studies.paper_folder import write_paper_folder
from needlefit.studies.report import rebuild, write_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports") / "study1"
    write_run(study(1), folder)
    return folder


def test_a_metric_that_was_added_since_has_no_value_in_a_stored_result(folder, tmp_path, monkeypatch):
    added = Metric("new_mm", "New", "mm", "A metric of a later version.", compute=lambda curves: 1.0)
    monkeypatch.setattr(METRICS, "_builtin_names", (*METRICS.names(), "new_mm"))
    monkeypatch.setitem(METRICS._builtin, "new_mm", added)
    shutil.copytree(folder, tmp_path / "study1")
    one = rebuild(tmp_path / "study1", tmp_path / "again")
    rows = pd.read_csv(tmp_path / "again/validation.csv")
    assert rows.loc[rows["metric"] == "new_mm", "value"].isna().all() and len(one.verdicts) == 1
    assert rows.loc[rows["metric"] == "te_mm", "value"].notna().any()


def test_every_table_is_marked_synthetic(folder):
    assert json.loads((folder / "timing.json").read_text()) == {"out": "somewhere", "seconds": 12.5}
    for path in folder.glob("*.tex"):
        assert path.read_text().count(r"\caption{SYNTHETIC data.") == path.read_text().count(r"\caption{")


def test_a_run_that_was_stopped_before_its_first_start_can_be_written(tmp_path):
    names = ("errors", "shapes", "parameters", "directions", "starts")
    nothing = {name: pd.DataFrame(columns=list(FRAMES[name])) for name in names}
    files = write_run(study(1).with_frames(**nothing), tmp_path / "stopped")
    assert "report.pdf" in {path.name for path in files.iterdir()}
    assert "validation.csv" not in {path.name for path in files.iterdir()}


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="LaTeX is not installed")
@pytest.mark.sweep
def test_the_latex_files_compile(tmp_path):
    """Those of a run's folder, and of a paper's folder made from it."""
    run, paper = write_run(study(1), tmp_path / "study1"), tmp_path / "paper"
    write_paper_folder(study(1), run, paper)
    head = r"\documentclass[journal]{IEEEtran}\usepackage[T1]{fontenc}\usepackage{textcomp,booktabs,siunitx}"
    words = ("pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex")
    for folder in (run, paper):
        names = sorted(path.stem for path in folder.glob("*.tex"))
        body = "\n".join(rf"\input{{{name}}}" for name in names)
        text = f"{head}\n\\begin{{document}}\n{body}\n\\end{{document}}\n"
        (folder / "all.tex").write_text(text)
        subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL)
