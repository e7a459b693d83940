"""A cohort: one fit for each specimen of many datasets, in one table."""

import os
import pickle
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from needlefit.datasets.sources import digest_folders
from needlefit.errors import ConfigError, DataError
from needlefit.project.locate import find_file
from needlefit.studies.held_out_predictions import find_fit
from needlefit.studies.job import Fold, Settings, prepare
from needlefit.studies.kinds import cohort as cohort_run
from needlefit.studies.kinds.cohort import find_datasets, run
from needlefit.studies.kinds.specimens import REPORT, SpecimensRecord
from needlefit.studies.kinds.specimens import run as run_specimens
from needlefit.studies.report import write_run
from needlefit.studies.run import Run
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
    study = check_study(
        {**COHORT, "kind": "specimens", "dataset": "twin", "tune": {"specimens": ["chicken-piece2"]}}, "x"
    )
    job = prepare("cohort specimens/a", study.tuning(), Settings())
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
    (warning,) = run("cohort", cohort("specimens/*"), stopped).run["warnings"]
    assert warning["kind"] == "same_dataset" and "specimens/again" in warning["what"]
    assert run("cohort", cohort("specimens/a"), stopped).run["warnings"] == []


def test_files_elsewhere_that_a_dataset_names_count_for_its_digest(project):
    shutil.copytree("specimens/b", "specimens/outside")
    Path("specimens/b/dataset.toml").write_text('root = "../outside"', encoding="utf-8")
    before = digest_folders(Path("specimens/b/dataset.toml"))
    Path("specimens/outside/insertions.csv").write_text("id", encoding="utf-8")
    assert digest_folders(Path("specimens/b/dataset.toml")) != before


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


CHICKEN = {
    "schema": 1,
    "kind": "specimens",
    "dataset": "twin",
    "medium": "chicken",
    "recipe": "quick",
    "tune": {"insertions": ["chicken-03", "chicken-09"]},
}
RECOVERY = {"specimens": 3, "replicates": 1, "spreads": [0.0], "mean": {"mu1_pa": 2e4, "bevel_mm": 0.15}}


@pytest.fixture(scope="module")
def two() -> Run:
    return run_specimens("two", SpecimensRecord.model_validate(CHICKEN), Settings())


def test_two_specimens_do_not_determine_a_spread(two, tmp_path):
    answer = two
    table = answer.frames["population"].set_index(["quantity", "parameter"])
    assert table["low_95"]["spread", "bevel_mm"] == 0.0
    new, mean = (table["high_95"][w, "mu1_pa"] - table["low_95"][w, "mu1_pa"] for w in ("new", "mean"))
    assert new > mean  # a further specimen differs besides
    assert REPORT.summarize(answer)[0].startswith("Spread")
    assert any("bounds" in line for line in REPORT.summarize(answer)[1:])
    written = write_run(answer, tmp_path / "o")
    assert (written / "specimens.pdf").is_file()
    # what a figure draws: more than the frame of its name
    drawn = pd.read_csv(written / "densities.csv")
    assert {"level", "high"} <= set(drawn) - set(answer.frames["densities"])


def test_posteriors_truncated_by_a_bound_are_named(two):
    every = two.frames["specimens"].copy()
    top = np.log(two.run["parts"][0]["medium"]["parameters"]["mu1_pa"]["bounds"][1])
    first = (every["parameter"] == "mu1_pa") & (every["specimen"] == every["specimen"].iloc[0])
    every["sd"] = 0.1
    for away, expected in ((0.19, f"μ₁ of {every['specimen'].iloc[0]}"), (0.21, "")):
        every["mean"] = every["parameter"].map({"mu1_pa": top - 1, "bevel_mm": np.log(0.1)})
        every.loc[first, "mean"] = top - away
        lines = REPORT.summarize(replace(two, frames={**two.frames, "specimens": every}))
        assert (
            "".join(line.split(": ")[1].split(".")[0] for line in lines if "posteriors" in line) == expected
        )


def test_intervals_cover_the_synthetic_population(tmp_path):
    changed = {**CHICKEN, "tune": {"insertions": ["chicken-03"]}, "recovery": RECOVERY}
    answer = run_specimens("made", SpecimensRecord.model_validate(changed), Settings())
    found = answer.frames["recovered"]
    truths = found[found["quantity"] == "mean"].set_index("parameter")["truth"]
    assert truths["mu1_pa"] == pytest.approx(np.log(2e4))
    assert set(found[found["quantity"] == "spread"]["truth"]) == {0.0}
    coverage = answer.frames["coverage"]
    spreads = coverage[(coverage["quantity"] == "spread") & (coverage["level"] == 0.95)]
    held = found[(found["quantity"] == "spread") & (found["low_95"] == 0.0)]
    assert spreads["covered"].sum() == len(held)
    assert REPORT.draw(answer, tmp_path)[0]["recovered"].is_file()
    assert any("True spread 0" in line for line in REPORT.summarize(answer))


def test_a_population_of_one_and_a_mean_left_out_are_refused():
    one = {**CHICKEN, "tune": {"insertions": ["chicken-03"]}}
    with pytest.raises(ConfigError, match="only one specimen"):
        run_specimens("one", SpecimensRecord.model_validate(one), Settings())
    short = {**CHICKEN, "recovery": {**RECOVERY, "mean": {"mu1_pa": 2e4}}}
    with pytest.raises(ConfigError, match="bevel_mm"):
        run_specimens("short", SpecimensRecord.model_validate(short), Settings())


def test_impossible_populations_are_refused():
    for changed, fault in (
        ({"spreads": [-0.1]}, "greater than or equal to 0"),
        ({"specimens": 2}, "equal to 3"),
    ):
        with pytest.raises(ValueError, match=fault):
            SpecimensRecord.model_validate({**CHICKEN, "recovery": {**RECOVERY, **changed}})
    for mean, fault in (({"mu1_pa": -1.0}, "not within the bounds"), ({"mu9_pa": 1.0}, "not free")):
        wrong = {**CHICKEN, "recovery": {**RECOVERY, "mean": {**RECOVERY["mean"], **mean}}}
        with pytest.raises(ConfigError, match=fault) as error:
            run_specimens("wrong", SpecimensRecord.model_validate(wrong), Settings())
        assert "`recovery.mean." in error.value.where and "wrong" in error.value.where
