"""One insertion that was measured at several depths: one bevel in the likelihood and in predictions."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, assert_one_density, dataset, insertion, measure, medium, problem

from needlefit.datasets.insertion import Noise
from needlefit.datasets.select import find_repeats
from needlefit.inference.predict import Draws
from needlefit.schemas.recipe import LikelihoodRecord, RecipeRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.folds import Fold
from needlefit.studies.held_out_predictions import predict_held_out
from needlefit.studies.job import Job

NAMES = ("A", "B", "C", "D", "E")
FINE = Noise(0.0, 0.02, 0.0, 5.0)


def holes(depths=(32.0, 36.0), factors=(1.0,) * 5):
    """One shape for each hole and depth, each hole with a bevel of its own."""
    record = medium(1)
    return [
        replace(
            measure(TRUTH, record, replace(insertion(depth, angle_sd=0.0), bevel_factor=factor)),
            id=f"{name}{depth:g}",
            specimen=name,
            bevel_factor=1.0,
        )
        for name, factor in zip(NAMES, factors, strict=True)
        for depth in depths
    ]


def test_repeats_are_depths_of_one_specimen_among_several():
    made = holes()
    assert find_repeats(dataset(made)) == {one.id: (one.specimen, NAMES.index(one.specimen)) for one in made}
    assert find_repeats(dataset(made[:8])) == {}  # four specimens alone
    assert find_repeats(dataset([replace(one, depth=30.0) for one in made])) == {}
    apart = [replace(one, frame=replace(one.frame, origin=np.array([0, one.depth, 0]))) for one in made]
    assert find_repeats(dataset(apart)) == {}
    assert len(find_repeats(dataset(apart, pose="free"))) == len(made)


def test_repeats_have_exact_gradients_and_one_condition_a_hole():
    p = problem(medium(1), holes(), how=LikelihoodRecord(depths="fixed"), noise=FINE)
    theta = p.parameters.theta({**TRUTH, "bevel_spread": 0.07}) + 0.05
    assert_one_density(p, theta, rtol=1e-4)
    rows = sum(known.rows for known in p.density.observations)
    # of each depth one condition that is nobody else's (of weight 0), of each hole the bevel
    assert sum(p.density.residual_counts) == rows + 10 + 5
    alone = replace(p, dataset=replace(p.dataset, insertions=p.insertions[:1]))
    assert alone.log_posterior(theta) != pytest.approx(p.log_posterior(theta), abs=0.5)


BENT = math.log(1.15)  #: logarithm of the bevel's factor in the last hole


@pytest.fixture(scope="module")
def job():
    made = holes(factors=(1.0, 1.0, 1.0, 1.0, math.exp(BENT)))
    record = medium(1)
    p = problem(record, made, how=LikelihoodRecord(depths="fixed"), noise=FINE)
    study = StudyRecord.model_validate(
        {"schema": 2, "dataset": "cases", "medium": "test", "recipe": "default", "leave_out": "specimen"}
    )
    return Job(
        "holes", study, p.dataset, record, p.parameters, RecipeRecord.model_validate({"schema": 2}), None, ()
    )


def predict(job, tune, held):
    """The predicted tips of depths that are held out, in units of the bevel's spread of 0.1."""
    known = [one for one in job.dataset.insertions if one.id in tune]
    wanted = [one for one in job.dataset.insertions if one.id in held]
    theta = job.parameters.theta({**TRUTH, "bevel_spread": 0.1})
    draws = Draws(np.repeat(theta[None], 300, axis=0), "importance")
    rows = predict_held_out(job, Fold("one", tuple(known), tuple(wanted)), draws)
    return [one.row for one in rows]


def test_a_depth_of_a_known_hole_is_predicted_with_the_bevel_of_that_hole(job):
    everything = [one.id for one in job.dataset.insertions]
    (new,) = predict(job, everything[:8], ["E36"])
    (known,) = predict(job, everything[:9], ["E36"])
    width = {name: row["tip_95_high_mm"] - row["tip_95_low_mm"] for name, row in (("n", new), ("k", known))}
    assert width["k"] < 0.5 * width["n"]
    off = [abs(row["tip_median_mm"] - row["tip_measured_mm"]) for row in (known, new)]
    assert off[0] < 0.2 * off[1]


def test_the_depths_of_a_hole_left_out_have_one_bevel(job):
    everything = [one.id for one in job.dataset.insertions]
    shallow, deep = predict(job, everything[:8], ["E32", "E36"])
    tips = [row["tip_median_mm"] / row["tip_measured_mm"] for row in (shallow, deep)]
    assert tips[0] == pytest.approx(tips[1], rel=2e-3)  # 300 independent draws would differ by 1 %
