"""`validate` and `tune`: what they print, write, and how they end; the fitting itself is made up here."""

import dataclasses
import json
from pathlib import Path

import pandas as pd
import pytest
from reporting_results import study, with_frames
from test_cli import run

from needlefit.cli import screen
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.result_warnings import ResultWarning, to_stored_rows
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.kind import kind_of
from needlefit.studies.kinds.cross_validation.run import find_faults

STUDY = 'schema = 1\ntitle = "Mine"\ndataset = "twin"\nmedium = "phantom2"\nvalidate = [{}]\n'
FIT = 'schema = 1\ndataset = "twin"\nmedium = "phantom2"\n'


class Stub:
    """Stands for the run of a study; keeps what it was asked."""

    def __init__(self, results):
        self.results, self.asked, self.written = results, [], []

    def run(self, name, record, settings):
        settings.progress("starts", 1, 2)
        if settings.checkpoint is not None:
            settings.checkpoint.mkdir(parents=True, exist_ok=True)
        self.asked.append((name, record, settings))
        found = dataclasses.replace(self.results, kind=kind_of(record).name, name=name, record=record)
        return dataclasses.replace(found, faults=find_faults(found.frames["errors"], {}, {}))

    def write(self, results, folder):
        folder.mkdir(parents=True)
        self.written.append((results, folder))
        return folder


@pytest.fixture
def stub(tmp_path, monkeypatch):
    for folder, name, text in (("studies", "mine", STUDY), ("configs/fits", "gel", FIT)):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / f"{name}.toml").write_text(text)
    monkeypatch.chdir(tmp_path)

    def install(results):
        made = Stub(results)
        monkeypatch.setattr("needlefit.studies.kinds.cross_validation.run.run", made.run)
        monkeypatch.setattr("needlefit.studies.report.write_run", made.write)
        return made

    return install


def test_validate_writes_prints_and_removes_the_checkpoint(stub, capsys):
    made = stub(study(1))
    assert run("validate mine --seed 7 --jobs 2") == 0
    ((name, record, settings),) = made.asked
    assert (name, type(record)) == ("mine", StudyRecord)
    assert (settings.seed, settings.jobs, settings.resume, settings.sample) == (7, 2, False, False)
    assert made.written[0][1] == Path("reports/mine")
    assert not Path("reports/mine.partial").exists()
    assert max(map(len, capsys.readouterr().out.splitlines())) <= screen.SCREEN_COLUMNS


def test_a_warning_names_its_page_and_with_strict_ends_in_exit_code_5(stub, capsys):
    warned = to_stored_rows([ResultWarning("parameter_at_bound", "mu1 lies at its bound")])
    stub(study(1).with_metadata(warnings=warned))
    assert run("validate mine") == 0
    assert "needlefit explain parameter-at-bound" in capsys.readouterr().err
    assert run("validate mine --out again --strict --json") == 5
    assert [one["kind"] for one in json.loads(capsys.readouterr().out)["warnings"]] == ["parameter_at_bound"]


def test_validate_reference_writes_evidence(stub):
    made = stub(study(1))
    assert run("validate mine -q") == 0
    assert not Path("reports/reference").exists()
    assert run("validate mine --reference --out new -q") == 0
    assert made.written[1][1] == Path("new/mine")
    evidence = pd.read_csv("new/reference/mine/validation.csv")
    assert all(f"{value:.5g}" == f"{value:.9g}" for value in evidence["value"])
    assert "validity" not in json.loads(Path("new/reference/mine/run.json").read_text())


def test_simulations_that_fail_are_marked_by_the_exit_code(stub):
    made = stub(study(3))
    assert run("validate mine") == 5 and made.written


@pytest.mark.parametrize(
    ("line", "found", "written"),
    [
        ("validate mine --seed 7", True, 0),
        ("tune gel", True, 1),  # the best so far, marked
        ("tune gel", False, 0),  # an earlier result stays
    ],
)
def test_an_interrupted_run_keeps_its_checkpoint_and_prints_how_to_resume(line, found, written, stub, capsys):
    results = study(1)
    if not found:
        results = with_frames(results, errors=results.frames["errors"].query("method != 'fitted'"))
    made = stub(dataclasses.replace(results, interrupted=True))
    assert run(line) == 130
    assert [results.interrupted for results, _ in made.written] == [True] * written
    assert len([*Path("reports").glob("*.partial")]) == 1
    assert f"{line} --resume\n" in capsys.readouterr().err


def test_unfinished_work_of_a_killed_run_is_kept_and_the_next_start_prints_how_to_go_on(stub, capsys):
    made = stub(study(1))

    def run_with_checkpoint(name, record, settings):
        open_checkpoint(settings.checkpoint, settings.resume, {"n": 1})
        return made.run(name, record, settings)

    with pytest.MonkeyPatch.context() as here:
        here.setattr("needlefit.studies.kinds.cross_validation.run.run", run_with_checkpoint)
        open_checkpoint(Path("reports/gel.partial"), False, {"n": 1}).keep_row("a", {"b": 0})
        assert run("tune gel") == 3
        assert "needlefit tune gel --resume\n" in capsys.readouterr().err
        assert made.written == [] and list(Path("reports/gel.partial").glob("*.jsonl"))
        assert run("tune gel --resume") == 0
    assert made.written and not Path("reports/gel.partial").exists()


def test_tune_of_a_study_tunes_only(stub, capsys):
    made = stub(study(1))
    assert run("tune mine --out", "mine out", "--explain") == 0
    ((name, record, settings),) = made.asked
    assert (name, type(record), settings.sample) == ("mine-tune", FitRecord, True)
    assert record.medium == "phantom2"
    assert made.written[0][1] == Path("mine out/mine-tune")
    assert "mine out/mine-tune/" in capsys.readouterr().out


def test_tune_searches_and_fixes_parameters_by_name_and_its_folder_has_these_names(stub, capsys):
    made = stub(study(1))
    assert run("tune gel --free alpha --fix b=0.05 --fix mu1=2e5") == 0
    ((name, record, _),) = made.asked
    assert name == "gel-free=alpha-b=0.05-mu1=200000"
    assert record.free == ("alpha",) and record.fix == {"bevel_mm": 0.05, "mu1_pa": 2e5}
    assert run("tune gel --fix b=thick") == 2 and "b=thick" in capsys.readouterr().err
    assert run("tune gel --free alpha1 --fix alpha1=1") == 3
