"""A cohort: one fit for each specimen of many datasets, in one table."""

import os
import pickle
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from needlefit.datasets.folds import Fold
from needlefit.errors import ConfigError, DataError
from needlefit.project.locate import find_file
from needlefit.schemas.study import FitRecord
from needlefit.studies.fold_draws import find_fit
from needlefit.studies.job import Settings
from needlefit.studies.kinds import cohort as cohort_run
from needlefit.studies.kinds.cohort import find_datasets, run
from needlefit.studies.load import load_study
from needlefit.studies.report import write_run
from needlefit.studies.study_files import check_study

CHOSEN = ["chicken-01", "chicken-04", "chicken-05"]
COHORT = {"schema": 2, "kind": "cohort", "medium": "chicken", "recipe": "few", "tune": {"insertions": CHOSEN}}


@pytest.fixture
def project(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipe = find_file("recipe", "quick").read_text(encoding="utf-8").replace("starts = 4", "starts = 1")
    Path("configs/recipes").mkdir(parents=True)
    Path("configs/recipes/few.toml").write_text(recipe, encoding="utf-8")
    shutil.copytree(find_file("dataset", "twin").parent, "specimens/a")
    Path("specimens/b").mkdir()
    Path("specimens/b/dataset.toml").write_text("schema = 1\n", encoding="utf-8")
    Path("specimens/c").mkdir()  # no dataset
    return tmp_path


def cohort(*datasets):
    return check_study({**COHORT, "datasets": list(datasets)}, "cohort.toml")


@pytest.mark.sweep
def test_a_cohort_has_the_fits_of_its_specimens_and_what_could_not_be_fitted(project):
    result = run("cohort", cohort("specimens/*"), Settings())
    fits, failures = result.frames["fits"], result.frames["failures"]
    assert failures["dataset"].tolist() == ["specimens/b"] and "name" in failures["note"][0]
    assert failures["origin"].tolist() == ["none"]  # of nothing that was read
    assert {"specimens/b", "failures.csv"} <= set(re.findall(r"[\w./]+\w", result.verdicts[0].sentence))
    assert fits["specimen"].drop_duplicates().tolist() == ["chicken-piece1", "chicken-piece2"]
    assert result.origin == "synthetic"
    keys = {key: COHORT[key] for key in ("schema", "medium", "recipe")}
    record = FitRecord.model_validate({**keys, "dataset": "twin", "tune": {"specimens": ["chicken-piece2"]}})
    job = load_study("cohort specimens/a", record, Settings())
    kept = tuple(one for one in job.folds[0].tune if one.id in CHOSEN)
    alone = find_fit(job, job.problem(Fold("piece", kept, ())), ("chicken-piece2",), Settings())
    found = fits[fits["specimen"] == "chicken-piece2"].set_index("parameter")["value"]
    assert found.to_dict() == {name: alone.values[name] for name in found.index}
    folder = write_run(result, project / "out")
    assert pd.read_csv(folder / "failures.csv")["origin"].tolist() == ["none"]


def test_a_pattern_that_matches_nothing_is_an_error(project):
    with pytest.raises(ConfigError, match="matches no dataset"):
        find_datasets(cohort("nowhere/*"))
    assert find_datasets(cohort("specimens/a", "specimens/[ab]")) == [
        Path("specimens/a/dataset.toml"),
        Path("specimens/b/dataset.toml"),
    ]


def test_datasets_are_read_one_by_one_as_they_are_sent(project, monkeypatch):
    """A pool of another machine, in whose folder is nothing; memory would grow if all were read at first."""
    for name in ("d", "e"):
        shutil.copytree("specimens/b", f"specimens/{name}")
    read_files, away = [], project / "away"
    away.mkdir()

    def refuse(file):
        read_files.append(file)
        raise DataError("of another kind", where=str(file))

    class SendingPool:
        remote = True

        def run(self, work, items, stop):
            for n, item in enumerate(items):
                data = pickle.dumps(item)
                assert len(read_files) == n + 1
                os.chdir(away)
                yield n, work(pickle.loads(data))
                os.chdir(project)

    monkeypatch.setattr(cohort_run, "read", refuse)
    with pytest.raises(ConfigError) as caught:
        run("cohort", cohort("specimens/[bde]"), Settings(pool=SendingPool()))
    assert "specimens/b" in caught.value.expected and len(read_files) == 3


def test_a_dataset_that_is_listed_twice_by_its_content_is_a_warning(project):
    shutil.copytree("specimens/a", "specimens/again")
    stopped = Settings(stop=lambda: True)
    (warning,) = run("cohort", cohort("specimens/*"), stopped).warnings
    assert warning.kind == "same_dataset" and "specimens/again" in warning.what
    assert run("cohort", cohort("specimens/a"), stopped).warnings == ()


def _edit(name, text, other):
    file = Path(f"configs/{name}.toml")
    file.write_text(file.read_text(encoding="utf-8").replace(text, other), encoding="utf-8")


@pytest.mark.parametrize(
    "change",
    [
        lambda settings: _edit("recipes/few", "starts = 1", "starts = 2"),
        lambda settings: _edit("media/meat", "layers = 1", 'layers = 1\nnote = "another"'),
        lambda settings: replace(settings, seed=5),
    ],
    ids=["recipe", "medium", "seed"],
)
def test_a_resume_with_other_inputs_is_refused(project, change):
    Path("configs/media").mkdir()
    shutil.copy(find_file("medium", "chicken"), "configs/media/meat.toml")
    study = cohort("specimens/a").model_copy(update={"medium": "meat"})
    settings = Settings(checkpoint=project / "partial", stop=lambda: True)
    assert run("cohort", study, settings).interrupted
    settings = replace(settings, resume=True)
    assert run("cohort", study, settings).interrupted
    with pytest.raises(ConfigError):
        run("cohort", study, change(settings) or settings)
