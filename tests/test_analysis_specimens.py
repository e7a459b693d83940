"""Specimens of one medium: what few of them leave open, and a known population made up and found again."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from needlefit.errors import ConfigError
from needlefit.studies.job import Settings
from needlefit.studies.kinds.specimens import REPORT, SpecimensRecord, run
from needlefit.studies.report import write_run
from needlefit.studies.run import Run

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
    return run("two", SpecimensRecord.model_validate(CHICKEN), Settings())


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
    answer = run("made", SpecimensRecord.model_validate(changed), Settings())
    found = answer.frames["recovered"]
    truths = found[found["quantity"] == "mean"].set_index("parameter")["truth"]
    assert truths["mu1_pa"] == pytest.approx(np.log(2e4))
    assert set(found[found["quantity"] == "spread"]["truth"]) == {0.0}
    coverage = answer.frames["coverage"]
    spreads = coverage[(coverage["quantity"] == "spread") & (coverage["level"] == 0.95)]
    held = found[(found["quantity"] == "spread") & (found["low_95"] == 0.0)]
    assert spreads["covered"].sum() == len(held)
    assert REPORT.draw(answer, tmp_path)["recovered"].is_file()
    assert any("True spread 0" in line for line in REPORT.summarize(answer))


def test_a_population_of_one_and_a_mean_left_out_are_refused():
    one = {**CHICKEN, "tune": {"insertions": ["chicken-03"]}}
    with pytest.raises(ConfigError, match="only one specimen"):
        run("one", SpecimensRecord.model_validate(one), Settings())
    short = {**CHICKEN, "recovery": {**RECOVERY, "mean": {"mu1_pa": 2e4}}}
    with pytest.raises(ConfigError, match="bevel_mm"):
        run("short", SpecimensRecord.model_validate(short), Settings())


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
            run("wrong", SpecimensRecord.model_validate(wrong), Settings())
        assert "`recovery.mean." in error.value.where and "wrong" in error.value.where
