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
from needlefit.reporting.figures.style import choose_vertical_scale
from needlefit.studies.combined_report import write_combined
from needlefit.studies.fit_frames import COLUMNS
from needlefit.studies.kinds.cross_validation.report import format_macros, format_methods, format_references
from needlefit.studies.paper_folder import write_paper_folder
from needlefit.studies.report import compose_run_report, say, write_run

FIGURES = ("boxplot", "schematic", "overlays", "waterfall")
EXPECTED = {
    *(f"{name}.csv" for name in ("design", "directions", "errors", "failures", "shapes", "starts")),
    *(f"{name}.csv" for name in ("validation", "tuning", "parameters")),
    *(f"{name}.tex" for name in ("validation", "tuning_by_layers", "tuning_by_media", "parameters")),
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


def test_every_table_is_marked_synthetic(folder):
    assert json.loads((folder / "timing.json").read_text()) == {"out": "somewhere", "seconds": 12.5}
    for path in folder.glob("*.tex"):
        assert path.read_text().count(r"\caption{SYNTHETIC DATA.") == path.read_text().count(r"\caption{")


@pytest.mark.sweep
def test_the_report_warns_before_any_number():
    document = compose_run_report(study(1), {})
    assert document.synthetic
    assert "consistency" in document.blocks[0]["text"]
    assert "INTERRUPTED" in compose_run_report(study(2), {}).blocks[1]["text"]
    assert "NOT CONVERGED" in compose_run_report(study(3), {}).blocks[1]["text"]
    measured = compose_run_report(stereo(), {})
    assert not measured.synthetic
    assert measured.blocks[0]["kind"] == "verdict"


@pytest.mark.sweep
def test_all_studies_together(tmp_path):
    files = write_combined([study(1), study(5)], tmp_path / "all")
    assert {"validation.csv", "tuning.csv", "parameters.csv", "boxplot.pdf", "report.pdf"} <= {
        path.name for path in files
    }
    groups = pd.read_csv(tmp_path / "all" / "validation.csv").drop_duplicates(["study", "medium", "layers"])
    assert groups["study"].tolist() == [1, 1, 1, 5]
    assert set(json.loads((tmp_path / "all" / "run.json").read_text())) == {"study1", "study5"}


def test_a_run_that_was_stopped_before_its_first_start_can_be_written(tmp_path):
    names = ("errors", "shapes", "parameters", "directions", "starts")
    nothing = {name: pd.DataFrame(columns=list(COLUMNS[name])) for name in names}
    files = write_run(study(1).with_frames(**nothing), tmp_path / "stopped")
    assert "report.pdf" in {path.name for path in files.iterdir()}
    assert "validation.csv" not in {path.name for path in files.iterdir()}


@pytest.mark.sweep
@pytest.mark.usefixtures("blank_figures")
def test_a_fit_has_no_validation_table_but_a_report(tmp_path):
    whole = study(1)
    parts = {name: whole.frames[name] for name in ("errors", "shapes", "design")}
    tuned = whole.with_frames(**{k: v[v["role"] == "tune"] for k, v in parts.items()})
    names = {path.name for path in write_run(tuned, tmp_path / "fit").iterdir()}
    assert {"tuning.csv", "overlays.pdf", "waterfall.pdf", "report.pdf"} <= names
    assert not {"validation.csv", "boxplot.pdf"} & names


def test_stretch_is_the_largest_that_fits():
    assert choose_vertical_scale(60, 4) == 5  # 0.62 * 60 mm is 9.3 times 4 mm
    assert choose_vertical_scale(60, 0.3) == 100
    assert choose_vertical_scale(60, 60) == 1


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


def test_the_methods_paragraph_describes_this_run():
    text = say(run_of(), "methods")
    assert re.search(r"μ₁ and b \w+ estimated\b[^.]*\b2 insertions\b", text)
    assert re.search(r"α₁ was\b[^.]*\bfixed\b", text) and "α₁ were" not in text
    assert "16 starts" in text and "elements of 0.5 mm" in text and "needlefit 9.8.7" in text
    assert "3 insertions held out" in text and "R-hat" not in text
    assert re.search(r"posterior-mode\b[^.]*\b3 insertions", text) and "predicted with" not in text
    tied = {"mu2_pa": {"bounds": None, "fixed": None, "tie": "mu1_pa", "spread": None}}
    medium = {"parameters": RUN["medium"]["parameters"] | tied}
    assert re.search(r"μ₂ to μ₁\b[^.]*\bln 1\.2\b", say(run_of(medium=medium), "methods"))
    free = say(dataclasses.replace(stereo(), run=RUN), "methods")
    assert "rotated and shifted" in free and "rotated and shifted" not in text
    other = RECIPE | {"minimize": "metric", "algorithm": "sbplx+neldermead", "starts": 5}
    changed = say(run_of(recipe=other), "methods")
    assert re.search(r"SBPLX\b.*\bNELDERMEAD\b.*\b5 starts", changed) and "posterior" not in changed


@pytest.mark.parametrize(
    ("operator", "likelihood", "words"),
    [
        ("spline", {}, "coefficients"),
        ("spline", {"measurement": "points"}, "as they are"),
        ("spline", {"noise": "independent"}, "as they are"),
        ("gaussian", {}, "smoothed"),
        ("unknown", {}, "bias"),
    ],
)
def test_the_methods_paragraph_names_the_operator_and_what_insertions_share(operator, likelihood, words):
    data = {"measurement": {"operator": operator, "description": "MEASURED"}, "boundary_shared_sd_mm": [0.07]}
    recipe = RECIPE | {"likelihood": RECIPE["likelihood"] | likelihood}
    plain, text = (say(run_of(recipe=recipe, **more), "methods") for more in ({}, {"dataset": data}))
    assert "MEASURED" in text and words in text and words not in plain
    assert "0.07 mm" in text
    fixed = recipe | {"likelihood": recipe["likelihood"] | {"depths": "fixed"}}
    assert "0.07 mm" not in say(run_of(recipe=fixed, dataset=data), "methods")


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


def test_a_length_is_printed_to_a_hundredth_and_missing_cells_are_dashes():
    text = format_macros([study(5)])
    assert re.search(r"^\\nfnum\{study5-chicken-1-te\}\{\d+\.\d\d\}$", text, re.M)
    assert re.search(r"^\\nfnum\{study5-chicken-1-paper-edp\}\{500\}$", text, re.M)
    assert "nan" not in text and "None" not in text


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
