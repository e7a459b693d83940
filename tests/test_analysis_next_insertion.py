"""The next insertion: where candidates lie, what they meet, and that the deepest tells most of one layer."""

import math

import numpy as np
import pytest

from needlefit.inference.sampling.importance import Effort
from needlefit.studies import further_insertion
from needlefit.studies.further_insertion import WeightedPosterior, find_template
from needlefit.studies.job import Settings, prepare
from needlefit.studies.kinds import next_insertion
from needlefit.studies.kinds.next_insertion import (
    REPORT,
    CandidateEntryRecord,
    NextInsertionRecord,
    frame_of,
    predict_candidate,
)
from needlefit.studies.report import write_run

CHICKEN = {
    "schema": 1,
    "kind": "next_insertion",
    "dataset": "twin",
    "medium": "chicken",
    "recipe": "quick",
    "template_insertion": "chicken-02",
    "depths_mm": [10, 80],
    "tune": {"insertions": ["chicken-01"]},
    "entries": [{"name": "anywhere", "layers": [1]}],
    "quantities": [{"name": "tip at 60 mm", "entry": "anywhere", "depth_mm": 60}],
}
PHANTOM = {**CHICKEN, "medium": "phantom2", "tune": {"medium": "phantom2", "layers": [2]}, "quantities": []}


def test_an_angle_turns_the_needle_toward_its_bevel():
    entry = CandidateEntryRecord(
        name="top", position_mm=(0, 1, 2), direction=(2, 0, 0), bending_direction=(0, 1, 0)
    )
    frame = frame_of(entry, 30.0)
    half = math.sqrt(3) / 2
    assert frame.origin == pytest.approx([0, 1, 2])
    assert frame.rotation[:, 0] == pytest.approx([half, 0.5, 0])
    assert frame.rotation[:, 1] == pytest.approx([-0.5, half, 0])


def test_layers_are_those_listed_or_those_of_the_surfaces_on_the_planned_path():
    record = NextInsertionRecord.model_validate(PHANTOM)
    job = prepare("test", record.tuning(), Settings())
    like = find_template(job, "phantom2-06")
    values = {"mu1_pa": 2e5, "mu2_pa": 3e7, "bevel_mm": 1e-3, "alpha1": 1.0, "alpha2": -1.0}
    values |= {"mu3_pa": 2e5, "mu4_pa": 3e7, "alpha3": 1.0, "alpha4": -1.0}
    listed = CandidateEntryRecord(name="side", layers=(2, 3), boundaries_mm=(15.0,))
    assert predict_candidate(job, like, (listed, 0.0, 12.0), values).sequence == (2,)
    assert predict_candidate(job, like, (listed, 0.0, 20.0), values).sequence == (2, 3)
    # the interfaces lie at x = 19 and 27 mm: at 60 degrees a straight needle meets them twice as deep
    tilted = predict_candidate(
        job, like, (CandidateEntryRecord(name="top", position_mm=(0, -39, 30)), 60.0, 60.0), values
    )
    assert tilted.sequence == (1, 2, 3)
    assert tilted.boundaries == pytest.approx([38.0, 54.0], abs=0.1)


@pytest.mark.parametrize(
    ("entry", "fault"),
    [
        ({"name": "a", "boundaries_mm": [3.0]}, "there are none"),
        ({"name": "a", "layers": [1, 2]}, "n - 1"),
        ({"name": "a", "layers": [1], "angles_deg": [0, 10]}, "angles need surfaces"),
    ],
)
def test_an_entry_lists_all_of_its_layers(entry, fault):
    with pytest.raises(ValueError, match=fault):
        CandidateEntryRecord.model_validate(entry)


@pytest.mark.parametrize("ids", [["chicken-01"], ["chicken-01", "chicken-02", "chicken-03", "chicken-04"]])
def test_the_mean_bevel_of_all_needles_is_less_known_than_that_of_some(ids):
    record = NextInsertionRecord.model_validate({**CHICKEN, "tune": {"insertions": ids}})
    job = prepare("deeper", record.tuning(), Settings())
    problem = job.problem(job.folds[0])
    theta = problem.parameters.theta({"mu1_pa": 2e3, "bevel_mm": 0.3, "bevel_spread": 0.1})
    known = WeightedPosterior(problem, None, np.tile(theta, (4000, 1)), np.full(4000, 1 / 4000), 0.1)
    factors = np.exp(next_insertion.refer_to_all_needles(known, np.random.default_rng(1)).thetas - theta)
    sds = dict(zip(problem.names, factors.std(axis=0), strict=True))
    assert sds["bevel_mm"] == pytest.approx(0.1 / np.sqrt(len(ids)), rel=0.05)
    assert sds["mu1_pa"] == sds["bevel_spread"] == 0


def test_deep_insertions_into_one_layer_determine_mu_better_and_alpha_not_at_all(tmp_path, monkeypatch):
    monkeypatch.setattr(next_insertion, "OUTER_DRAWS", 40)
    monkeypatch.setattr(further_insertion, "PLANNING_EFFORT", Effort(draws=100, min_ess=150.0))
    answer = next_insertion.run("deeper", NextInsertionRecord.model_validate(CHICKEN), Settings())
    found = answer.frames["candidates"].set_index("depth_mm")
    assert found["nats"][80] > found["nats"][10] + 5 * found["nats_se"][10]
    tips = answer.frames["tips"].set_index("depth_mm")
    assert tips["sd_after_mm"][80] < tips["sd_after_mm"][10] < tips["sd_now_mm"][10]
    alphas = answer.frames["alphas"]
    assert np.all(alphas["sd_after"] > 0.99 * alphas["sd_now"])
    assert "80 mm deep" in REPORT.summarize(answer)[0]
    written = {path.name for path in write_run(answer, tmp_path / "out").iterdir()}
    assert {"gains.csv", "gains.pdf", "report.pdf", "report.html"} <= written
