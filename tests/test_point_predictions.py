"""The reported point of a predictive distribution, the mode's or the median, lies in its interval."""

import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.random import default_rng
from research.simulated_data import simulate_dataset

from needlefit import minimize
from needlefit.inference.likelihood.compared_points import align_points
from needlefit.inference.likelihood.observations import select_points
from needlefit.inference.point_prediction import PointPrediction, choose_point
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies.fold_draws import Specimens, draw_fold_parameters
from needlefit.studies.job import Inputs, Settings
from needlefit.studies.kinds.prediction.run import forecast, make_scene, tabulate_forecast
from needlefit.studies.load import load_study
from needlefit.studies.observations import predict_held_out

#: bounds as `needlefit import` writes them
MEDIUM = tomllib.loads("""
schema = 1
title = "gel"
layers = 1
parameters.mu1_pa.bounds = [1e3, 1e9]
parameters.alpha1.fixed = 1.0
parameters.bevel_mm.bounds = [1e-3, 1.0]
""")
SCENE = tomllib.loads("""
schema = 2
depth_mm = 60.0
bevel.offset_mm = 0.1
needle = { length_mm = 150.0, outer_diameter_mm = 1.27, youngs_modulus_gpa = 200.0 }
layers = [{ top_mm = 0.0, mu_pa = 2e5, alpha = 1.0 }]
""")


def load_needles(seed, pose):
    """Return the job of four needles by chance that are fitted, and two that are held out."""
    rng = default_rng(seed)
    mu, b = 10 ** rng.uniform(4.3, 5.4), 10 ** rng.uniform(-1.7, -0.6)
    insertions = [{"depth_mm": float(depth)} for depth in rng.uniform(40, 70, 6)]
    data = {
        "title": "needles",
        "values": {"mu1_pa": float(mu), "alpha1": 1.0, "bevel_mm": float(b)},
        "needle": SCENE["needle"],
        "noise": {"point_sd_mm": float(rng.uniform(0.03, 0.2))},
        "insertions": insertions,
    }
    dataset = replace(simulate_dataset(data, MEDIUM, seed), pose=pose)
    ids = [one.id for one in dataset.insertions]
    folds = {"tune": {"insertions": ids[:4]}, "validate": [{"insertions": ids[4:]}]}
    names = {"dataset": "needles", "medium": "gel", "recipe": "quick"}
    inputs = Inputs(dataset=dataset, medium=MediumRecord.model_validate(MEDIUM))
    return load_study(
        "needles", StudyRecord.model_validate({"schema": 2, **names, **folds}), Settings(inputs=inputs)
    )


def draw(job, seed):
    fit = minimize(job.problem(job.folds[0]), job.recipe, default_rng(seed))
    return Specimens(job, job.folds[0], draw_fold_parameters(job, job.folds[0], fit, Settings()).draws)


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("pose", ["known", "free"])
def test_a_predicted_needle_lies_in_its_interval(seed, pose):
    job = load_needles(seed, pose)
    known = draw(job, seed)
    planned = make_scene(SceneRecord.model_validate(SCENE), "scene", job.medium)
    for into in (None, job.folds[0].tune[0]):
        found = forecast(planned, known, into)
        table = tabulate_forecast(found)
        low, predicted, high = (table[f"needle_{name}_mm"] for name in ("95_low", "predicted", "95_high"))
        assert (low - 0.005 <= predicted).all() and (predicted <= high + 0.005).all()
    for held in predict_held_out(known, bands=True):
        insertion = next(one for one in job.insertions if one.id == held.insertion)
        (row,) = held.rows["predictive"]
        simulated, measured = align_points(select_points(pose, 0.0, insertion), held.curve)
        tip = row["tip_measured_mm"] + simulated[-1, 1] - measured[-1, 1]
        assert row["tip_95_low_mm"] <= tip <= row["tip_95_high_mm"]


def test_free_shapes_leave_b_at_a_bound_and_are_predicted_by_the_median():
    """The mode's tip lies 4 mm outside: `test_a_predicted_needle...` would fail by it."""
    job = load_needles(7, "free")
    known = draw(job, 7)
    planned = make_scene(SceneRecord.model_validate(SCENE), "scene", job.medium)
    found = forecast(planned, known, None)
    assert found.point.mode_fault == "at_bound" and "bevel_mm" in found.point.at_bound
    assert found.needle[:, 1] == pytest.approx(np.median(found.across[..., 0], axis=0))


#: a problem of two parameters, of which the first alone moves what is predicted
LINE = SimpleNamespace(
    lower=np.zeros(2), upper=np.ones(2), parameters=SimpleNamespace(free=("mu1_pa", "mu2_pa"), held=())
)


@pytest.mark.parametrize(
    ("mode", "point"),
    [
        ((0.5, 0.5), PointPrediction()),
        ((0.5, 1.0), PointPrediction()),  # at its bound it moves nothing
        ((1.0, 0.5), PointPrediction("at_bound", {"mu1_pa": "upper"})),
        ((0.0, 0.5), PointPrediction("at_bound", {"mu1_pa": "lower"})),
        ((0.985, 0.5), PointPrediction("outside")),  # above 97.5 % of the draws
        ((0.97, 0.5), PointPrediction()),
    ],
)
def test_the_mode_is_reported_within_its_bounds_and_the_central_95_percent(mode, point):
    draws = np.linspace(0.0, 1.0, 1001)[:, None]
    found = choose_point(LINE, np.array(mode), draws, lambda theta: theta[:1])
    assert found == point
    reported = found.take(np.array(mode[:1]), draws)
    assert reported == pytest.approx(0.5 if found.is_median else mode[0])
