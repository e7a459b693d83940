"""A cohort: one fit for each specimen of many datasets, in one table."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from needlefit.errors import ConfigError
from needlefit.project.locate import find_file
from needlefit.studies.folds import Fold
from needlefit.studies.job import Settings, prepare
from needlefit.studies.kinds.cohort.run import find_datasets, run
from needlefit.studies.posterior_fit import find_fit
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


@pytest.mark.slow
def test_a_cohort_has_the_fits_of_its_specimens_and_what_could_not_be_fitted(project):
    result = run("cohort", cohort("specimens/*"), Settings())
    fits, failures = result.frames["fits"], result.frames["failures"]
    assert failures["dataset"].tolist() == ["specimens/b"] and "name" in failures["note"][0]
    assert fits["specimen"].drop_duplicates().tolist() == ["chicken-piece1", "chicken-piece2"]
    assert result.origin == "synthetic"
    study = check_study(
        {**COHORT, "kind": "specimens", "dataset": "twin", "tune": {"specimens": ["chicken-piece2"]}}, "x"
    )
    job = prepare("cohort specimens/a", study.tuning(), Settings())
    kept = tuple(one for one in job.folds[0].tune if one.id in CHOSEN)
    alone = find_fit(job, job.problem(Fold("piece", kept, ())), ("chicken-piece2",), Settings())
    found = fits[fits["specimen"] == "chicken-piece2"].set_index("parameter")["value"]
    assert found.to_dict() == {name: alone.values[name] for name in found.index}
    folder = write_run(result, project / "out")
    assert pd.read_parquet(folder / "fits.parquet").equals(fits)


def test_a_pattern_that_matches_nothing_is_an_error(project):
    with pytest.raises(ConfigError, match="matches no dataset"):
        find_datasets(cohort("nowhere/*"))
    assert find_datasets(cohort("specimens/a", "specimens/[ab]")) == [
        Path("specimens/a/dataset.toml"),
        Path("specimens/b/dataset.toml"),
    ]
