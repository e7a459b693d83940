"""Files: whole or not there, the same bytes every time, synthetic data called so."""

import json
import re
from pathlib import Path

import pandas as pd
import pytest
from reporting_results import stereo, study

from needlefit.reporting.figures.style import choose_vertical_scale
from needlefit.studies.combined_report import write_combined
from needlefit.studies.fit_frames import COLUMNS
from needlefit.studies.report import compose_run_report, write_run

FIGURES = ("boxplot", "schematic", "overlays", "residuals", "waterfall")
EXPECTED = {
    *(f"{name}.csv" for name in ("design", "directions", "errors", "failures", "shapes", "starts")),
    *(f"{name}.csv" for name in ("validation", "tuning", "parameters")),
    *(f"{name}.tex" for name in ("validation", "tuning_by_layers", "tuning_by_media", "parameters")),
    *(f"{name}.{kind}" for name in FIGURES for kind in ("pdf", "csv")),
    *(
        "numbers.tex",
        "example.tex",
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
    assert [p.name for p in folder.parent.iterdir()] == ["study1"]
    for name in EXPECTED:
        assert (folder / name).stat().st_size > 0
        if name.endswith(".pdf"):
            assert (folder / name).read_bytes().startswith(b"%PDF")


def test_every_table_is_marked_synthetic(folder):
    assert json.loads((folder / "timing.json").read_text()) == {"out": "somewhere", "seconds": 12.5}
    for path in folder.glob("*.tex"):
        assert path.read_text().count(r"\caption{SYNTHETIC DATA.") == path.read_text().count(r"\caption{")


def test_failures_are_counted_by_reason_where_there_are_any():
    """Start 0 of both fits fails 600 times, every fourth time because it does not converge; 20 are kept."""
    texts = [block.get("text") or "" for block in compose_run_report(study(1), {}).blocks]
    (warning,) = (text for text in texts if "failures.csv" in text)
    assert re.findall(r"\d+", warning) == ["1200", "9600", "40", "30", "10"]
    assert "30 over-compressed" in warning and "10 not converged" in warning


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
