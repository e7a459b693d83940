"""`validate` and `tune`: what they print, write, and how they end; the fitting itself is made up here."""

import dataclasses
import json
import re
from pathlib import Path

import pandas as pd
import pytest
from reporting_results import stereo, study
from test_cli import run

from needlefit.project import locate
from needlefit.schemas.study import FitRecord, StudyRecord

STUDY = 'schema = 1\ntitle = "Mine"\ndataset = "twin"\nmedium = "phantom2"\nvalidate = [{}]\n'
FIT = 'schema = 1\ndataset = "twin"\nmedium = "phantom2"\n'
with (locate.shipped_folder() / "data/paper/validation.csv").open(encoding="utf-8") as _file:
    COLUMNS = _file.readline().strip().split(",")


class Stub:
    """Stands for the run of a study; keeps what it was asked."""

    def __init__(self, results):
        self.results, self.asked, self.written = results, [], []

    def run(self, name, record, settings):
        settings.progress("starts", 1, 2)
        if settings.checkpoint is not None:
            settings.checkpoint.mkdir(parents=True, exist_ok=True)
        self.asked.append((name, record, settings))
        return dataclasses.replace(self.results, name=name, record=record, title="Made up")

    def write(self, results, folder, also):
        folder.mkdir(parents=True)
        self.written.append((results, folder))
        return []


@pytest.fixture
def stub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for folder, name, text in (("studies", "mine", STUDY), ("configs/fits", "gel", FIT)):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / f"{name}.toml").write_text(text)
    monkeypatch.chdir(tmp_path)

    def install(results) -> Stub:
        made = Stub(results)
        monkeypatch.setattr("needlefit.validation.run.run", made.run)
        monkeypatch.setattr("needlefit.reporting.run_folder.write", made.write)
        return made

    return install


def test_validate_writes_prints_and_removes_the_checkpoint(stub, capsys):
    made = stub(study(1))
    assert run("validate", "mine", "--seed", "7", "--jobs", "2") == 0
    ((name, record, settings),) = made.asked
    assert (name, type(record)) == ("mine", StudyRecord)
    assert (settings.seed, settings.jobs, settings.resume, settings.sample) == (7, 2, False, False)
    assert made.written[0][1] == Path("reports/mine")
    assert not Path("reports/mine.partial").exists()
    out = capsys.readouterr().out
    assert "SYNTHETIC data" in out and "noise floor" in out and "constant curvature" in out


def test_validate_json_has_the_paper_s_columns_first(stub, capsys):
    stub(study(1))
    Path("studies/mine.toml").write_text(STUDY.replace("validate", "paper_study = 1\nvalidate"))
    assert run("validate", "mine", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    metrics = COLUMNS[3:]
    assert all(list(row)[: len(COLUMNS)] == COLUMNS for row in rows)
    assert all(f"paper_{metric}" in row for row in rows for metric in metrics)
    three_layers = rows[0]
    assert (three_layers["study"], three_layers["validate_medium"], three_layers["validate_layers"]) == (
        1,
        "phantom2",
        3,
    )
    assert (three_layers["paper_te_mm"], three_layers["paper_edp_percent"]) == (0.14, 5.56)
    assert three_layers["origin"] == "synthetic"


def test_validate_reference_writes_evidence(stub):
    made = stub(study(1))
    assert run("validate", "mine", "-q") == 0
    assert not Path("reports/reference").exists()
    assert run("validate", "mine", "--reference", "--out", "new", "-q") == 0
    assert made.written[1][1] == Path("new/mine")
    evidence = pd.read_csv("new/reference/mine/validation.csv")
    assert (evidence["te_mm"] == evidence["te_mm"].round(3)).all()
    assert "searches" not in json.loads(Path("new/reference/mine/run.json").read_text())


def test_a_curve_that_beats_the_model_is_named(stub, capsys):
    stub(stereo())
    assert run("validate", "mine") == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert re.search(r": straight line \(", printed)


def test_simulations_that_fail_are_marked_by_the_exit_code(stub, capsys):
    made = stub(study(3))
    assert run("validate", "mine") == 5
    assert made.written
    assert "did not converge" in capsys.readouterr().err


def test_validate_interrupted_keeps_its_checkpoint_and_prints_how_to_resume(stub, capsys):
    made = stub(dataclasses.replace(study(1), interrupted=True))
    assert run("validate", "mine", "--seed", "7") == 130
    assert made.written == []
    assert Path("reports/mine.partial").is_dir()
    assert "validate mine --seed 7 --resume\n" in capsys.readouterr().err


def test_tune_of_a_study_tunes_only(stub, capsys):
    made = stub(study(1))
    assert run("tune", "mine", "--sample", "--out", "mine out") == 0
    ((name, record, settings),) = made.asked
    assert (name, type(record), settings.sample) == ("mine-tune", FitRecord, True)
    assert record.medium == "phantom2"
    assert made.written[0][1] == Path("mine out/mine-tune")
    out = capsys.readouterr().out
    assert re.search(r"NOT determined.*: alpha1: ", out)
    assert "b re-tuned" in out and "4 of 8 starts" in out
    assert "mu1_pa * bevel_mm^1.9" in out


def test_tune_never_prints_what_is_not_determined_as_a_value(stub, capsys):
    stub(study(1))
    assert run("tune", "gel", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    rows = {row["parameter"]: row for row in found["parameters"]}
    assert rows["alpha1"]["fitted"] == "not determined" and rows["alpha1"]["determined"] is False
    assert rows["bevel_mm"]["fitted"] == "0.0847"
    assert found["starts"][0]["objective"] is None  # infinite: every solve of that start failed
    assert (found["origin"], found["interrupted"]) == ("synthetic", False)


def test_tune_interrupted_writes_the_best_so_far_marked(stub, capsys):
    made = stub(dataclasses.replace(study(1), interrupted=True))
    assert run("tune", "gel") == 130
    assert made.written[0][0].interrupted
    captured = capsys.readouterr()
    assert "INTERRUPTED" in captured.out
    assert "tune gel --resume\n" in captured.err
    assert Path("reports/gel.partial").is_dir()


def test_a_wrong_study_is_refused_before_anything_runs(stub, capsys):
    made = stub(study(1))
    Path("studies/mine.toml").write_text(STUDY + "validat = 1\n")
    assert run("validate", "mine") == 3
    assert "`validat` is unknown" in capsys.readouterr().err
    assert made.asked == []


def test_tune_interrupted_before_anything_is_found_leaves_an_earlier_result(stub, capsys):
    results = study(1)
    nothing = results.errors.query("method != 'fitted'")
    made = stub(dataclasses.replace(results, interrupted=True, errors=nothing))
    assert run("tune", "gel") == 130
    assert made.written == []
    assert "tune gel --resume\n" in capsys.readouterr().err


def test_a_foreign_folder_is_refused_before_anything_runs(stub, capsys):
    made = stub(study(1))
    Path("reports/mine").mkdir(parents=True)
    Path("reports/mine/thesis.tex").write_text("years of work")
    assert run("validate", "mine") == 3
    assert "thesis.tex" in capsys.readouterr().err
    Path("file").write_text("")
    assert run("tune", "gel", "--out", "file/below") == 3
    assert re.search(r"/file: [\s\S]*--out", capsys.readouterr().err)
    assert made.asked == []
