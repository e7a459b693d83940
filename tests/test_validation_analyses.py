"""What every inquiry rests on: pieces that are kept, answers that are stored, evidence that is rounded."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import multivariate_normal

from needlefit.datasets.read import read
from needlefit.inference.forward_model import PreparedModel, make_batch, predict
from needlefit.inference.likelihood.observation import points_covariance
from needlefit.inference.parameters import (
    BEVEL_SPREAD,
    NOISE_SCALE,
    Parameters,
    with_hyperparameters,
)
from needlefit.mechanics.batch import simulate_batches
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.locate import find_file
from needlefit.schemas.recipe import LikelihoodRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Fold, Job, Settings
from needlefit.studies.reference import round_frame
from needlefit.studies.runner import run_tasks
from needlefit.synthetic.build import build_unscanned
from needlefit.synthetic.design import select_planned_insertions
from tests.inference_cases import NEEDLE, NOISE, dataset, insertion, measure, medium, squares_recipe

THIRD = 1 / 3
RECIPE = (Path(__file__).parent.parent / "configs/recipes/quick.toml").read_text(encoding="utf-8")


def _pieces(done: list[str]):
    def piece(key: str, value: float):
        def compute():
            done.append(key)
            return {
                "errors": [{"of": key, "te_mm": value}],
                **({"more": [{"of": key}]} if key == "b" else {}),
            }

        return compute

    values = {"a": THIRD, "b": np.float64(2 / 3), "c": float("inf"), "d": float("nan")}
    return {key: piece(key, value) for key, value in values.items()}


def _stopping_after(count: int, done: list[str]) -> Settings:
    return Settings(stop=lambda: len(done) >= count)


def test_interrupted_tasks_resume_to_the_same_rows(tmp_path):
    whole = list(run_tasks(_pieces([]), "x", Settings(), open_checkpoint(None, False, {})))
    assert [part["errors"][0]["of"] for part in whole] == ["a", "b", "c", "d"]
    assert whole[0]["errors"][0]["te_mm"] == THIRD and type(whole[1]["errors"][0]["te_mm"]) is float
    first: list[str] = []
    kept = open_checkpoint(tmp_path, False, {"work": 1})
    part = list(run_tasks(_pieces(first), "x", _stopping_after(3, first), kept))
    assert part == whole[:2]  # the third was caught half done
    second: list[str] = []
    again = list(run_tasks(_pieces(second), "x", Settings(), open_checkpoint(tmp_path, True, {"work": 1})))
    assert second == ["c", "d"]
    assert json.dumps(again) == json.dumps(whole)


class _BackwardPool:
    """Finishes the last task first; stops after so many."""

    remote = False

    def __init__(self, count: int) -> None:
        self._count = count

    def run(self, work, items, stop):
        for n in reversed(range(len(items))[-self._count :]):
            yield n, work(items[n])


@pytest.mark.parametrize(("count", "of"), [(4, "abcd"), (2, "cd")])
def test_rows_come_in_the_order_of_tasks_that_finish_in_another(count, of):
    parts = run_tasks(_pieces([]), "x", Settings(pool=_BackwardPool(count)), open_checkpoint(None, False, {}))
    assert [part["errors"][0]["of"] for part in parts] == list(of)


def test_a_task_row_keeps_no_value_that_json_would_change():
    tasks = {"a": lambda: {"x": [{"at": Path()}]}}
    with pytest.raises(TypeError, match="Path"):
        list(run_tasks(tasks, "x", Settings(), open_checkpoint(None, False, {})))


def test_evidence_is_rounded_to_five_decimals_of_a_length_and_five_digits():
    frame = pd.DataFrame(
        {
            "te_mm": [0.1234567, -0.000002, np.inf],
            "mu1_pa": [123456.0, 0.0, np.nan],
            "edp_percent": [12.34567, 0.001234567, 1e9 / 3],
            "insertions": [7, 8, 9],
            "note": ["a", "b", "c"],
        }
    )
    got = round_frame(frame)
    assert got["te_mm"].tolist() == [0.12346, 0.0, np.inf]
    assert str(got["te_mm"][1]) == "0.0"
    assert got["mu1_pa"].tolist()[:2] == [123460.0, 0.0] and np.isnan(got["mu1_pa"][2])
    assert got["edp_percent"].tolist() == [12.346, 0.0012346, 3.3333e8]
    assert got[["insertions", "note"]].equals(frame[["insertions", "note"]])


def test_a_twin_that_is_not_scanned_is_nearly_the_one_that_was(tmp_path):
    """Same truth, same places of the markers: what differs is what voxels add."""
    names = ("phantom2-03", "phantom3-05", "chicken-02")
    found = {
        one.id: one for one in read(build_unscanned(tmp_path, 1, select_planned_insertions(names))).insertions
    }
    scanned = {one.id: one for one in read(find_file("dataset", "twin")).insertions}
    for name in names:
        one, other = found[name], scanned[name]
        assert one.sequence == other.sequence and one.side == other.side
        assert one.depth == pytest.approx(other.depth, abs=0.2)
        assert one.deflection == pytest.approx(other.deflection, abs=0.3)
        np.testing.assert_allclose(one.boundaries, other.boundaries, atol=0.05)
        assert one.pose_shift_sd == pytest.approx(other.pose_shift_sd, rel=0.01)
    assert "not scanned" in read(tmp_path).notes[0]


TRUTH = {"mu1_pa": 3e5, "alpha1": 1.0, "bevel_mm": 0.08}


def test_further_points_add_their_whole_density():
    """Nothing that the likelihood drops is missing from the ratio of two posteriors."""
    made = [measure(TRUTH, medium(layers=1), insertion(30.0 + 6 * k), points=31) for k in range(2)]
    likelihood = LikelihoodRecord(noise_scale="estimated", measurement="points")
    parameters = with_hyperparameters(Parameters.from_record(medium(layers=1)), likelihood)
    recipe = squares_recipe(starts=2).model_copy(update={"likelihood": likelihood})
    fit = FitRecord.model_validate({"schema": 1, "dataset": "cases", "medium": "test"})
    job = Job("cases", fit, dataset(made), medium(layers=1), parameters, recipe, None, ())
    # all bevels are the same: a further one would change what b is the mean of
    theta = job.parameters.theta({**TRUTH, "bevel_mm": 0.1, NOISE_SCALE: 1.3, BEVEL_SPREAD: 1e-3})
    one, both = (job.problem(Fold("", tuple(some), ())) for some in (made[:1], made))
    s = both.density.observations[1].nodes.s[0]
    shape = predict(both.values(theta), medium(layers=1), NEEDLE, made[1])
    off = compute_positions(shape, s)[:, 1] - made[1].planar[:, 1]
    # Gaussian, with errors of points, pose and registration
    x = made[1].planar[:, 0] - made[1].planar[0, 0]
    slope = np.polynomial.Polynomial.fit(x, made[1].planar[:, 1], 5).deriv()(x)
    shift = NOISE.registration_mean / math.sqrt(8 / math.pi)
    modes = np.column_stack([shift * np.ones(len(x)), made[1].pose_angle_sd * x, -shift * slope])
    cov = 1.3**2 * points_covariance(s, NOISE) + modes @ modes.T
    exact = multivariate_normal.logpdf(off, cov=cov)
    assert both.log_posterior(theta) - one.log_posterior(theta) == pytest.approx(exact, abs=0.02)


MOVED = replace(insertion(40.0), base_moved=8.0)
THIN = medium(layers=1).model_copy(update={"thickness_mm": 5.0})
SOFT = {"mu1_pa": 3e3, "alpha1": 1.0, "bevel_mm": 0.03}


def test_a_base_that_moves_does_so_once_the_needle_is_in():
    bevel = Bevel(0.03)
    tissue = Tissue(np.array([3e-3]), np.array([1.0]), np.empty(0), np.array([5.0]))
    steps = (Step(40.0, bevel), Step(40.0, bevel, Controls(base_y=8.0)))
    shape = predict(SOFT, THIN, NEEDLE, MOVED)
    assert shape.u == pytest.approx(
        simulate_steps(NEEDLE, tissue, steps, ModelOptions(tolerance=1e-9)).u, abs=1e-9
    )
    still = predict(SOFT, THIN, NEEDLE, replace(MOVED, base_moved=0.0))
    assert shape.constraints == pytest.approx(still.constraints, abs=1e-9)  # the cut stays where it was
    assert compute_positions(shape, np.array([0.0]))[0, 1] > 1.0  # the tissue gives way at the entry
    (lanes,) = simulate_batches([make_batch([SOFT], THIN, NEEDLE, MOVED)])
    assert lanes.u[0] == pytest.approx(shape.u, abs=1e-6)


def test_a_moved_bases_needle_has_exact_derivatives():
    parameters = Parameters.from_record(THIN)
    theta, s = parameters.theta(SOFT), np.linspace(0.0, 40.0, 9)
    _, ((slopes,),) = PreparedModel(THIN, NEEDLE, [MOVED]).differentiate([SOFT], parameters, [s])
    for k, move in enumerate(1e-4 * np.eye(len(theta))):
        ends = [predict(parameters.values(theta + sign * move), THIN, NEEDLE, MOVED) for sign in (1, -1)]
        by = (compute_positions(ends[0], s) - compute_positions(ends[1], s)) / 2e-4
        assert slopes[:, :, k] == pytest.approx(by, rel=1e-3, abs=1e-6)
