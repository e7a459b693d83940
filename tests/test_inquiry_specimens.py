"""Specimens of one medium: what few of them leave open, and a known population made up and found again."""

import numpy as np
import pytest

from needlefit.errors import ConfigError
from needlefit.project.records.specimens import SpecimensRecord
from needlefit.reporting.inquiries.specimens import draw_all, said
from needlefit.reporting.inquiries.write import write_answer
from needlefit.validation.inquiries.specimens.verb import ask
from needlefit.validation.job import Settings

CHICKEN = {
    "schema": 1,
    "kind": "specimens",
    "dataset": "twin",
    "medium": "chicken",
    "recipe": "quick",
    "tune": {"insertions": ["chicken-03", "chicken-09"]},
}
RECOVERY = {"specimens": 3, "replicates": 1, "spreads": [0.0], "mean": {"mu1_pa": 2e4, "bevel_mm": 0.15}}


def test_two_specimens_tell_no_spread(tmp_path):
    answer = ask("two", SpecimensRecord.model_validate(CHICKEN), Settings())
    told = answer.frames["population"].set_index(["what", "parameter"])
    assert told["low_95"]["spread", "bevel_mm"] == 0.0
    new, mean = (told["high_95"][w, "mu1_pa"] - told["low_95"][w, "mu1_pa"] for w in ("new", "mean"))
    assert new > mean  # a further specimen differs besides
    assert "tells no spread" in said(answer)[0]
    assert {"densities.csv", "specimens.pdf"} <= {
        p.name for p in write_answer(answer, tmp_path / "o").iterdir()
    }


def test_intervals_are_held_against_the_population_that_was_made_up(tmp_path):
    changed = {**CHICKEN, "tune": {"insertions": ["chicken-03"]}, "recovery": RECOVERY}
    answer = ask("made", SpecimensRecord.model_validate(changed), Settings())
    found = answer.frames["recovered"]
    truths = found[found["what"] == "mean"].set_index("parameter")["truth"]
    assert truths["mu1_pa"] == pytest.approx(np.log(2e4))
    assert set(found[found["what"] == "spread"]["truth"]) == {0.0}
    coverage = answer.frames["coverage"]
    spreads = coverage[(coverage["what"] == "spread") & (coverage["level"] == 0.95)]
    held = found[(found["what"] == "spread") & (found["low_95"] == 0.0)]
    assert spreads["held"].sum() == len(held)
    assert draw_all(answer, tmp_path)["recovered"].is_file()
    assert "reached 0" in said(answer)[1]


def test_a_population_of_one_and_a_mean_left_out_are_refused():
    one = {**CHICKEN, "tune": {"insertions": ["chicken-03"]}}
    with pytest.raises(ConfigError, match="only one specimen"):
        ask("one", SpecimensRecord.model_validate(one), Settings())
    short = {**CHICKEN, "recovery": {**RECOVERY, "mean": {"mu1_pa": 2e4}}}
    with pytest.raises(ConfigError, match="bevel_mm"):
        ask("short", SpecimensRecord.model_validate(short), Settings())
