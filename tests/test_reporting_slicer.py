"""What 3D Slicer gets: curves of needles where they stand, with the band of the fit."""

import dataclasses
from types import SimpleNamespace

import needles
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from test_validation_run import made, project, study

from needlefit.datasets.formats.markups import read_markups
from needlefit.geometry.curves import arc_length
from needlefit.inference.draws import Draws
from needlefit.inference.fit import Callbacks
from needlefit.inference.optimize import minimize
from needlefit.project.random_streams import random_stream
from needlefit.reporting.slicer import write_needles
from needlefit.schemas.run_metadata import CountMetadata
from needlefit.studies.kinds.cross_validation.run import Settings, run
from needlefit.studies.load import load_study
from needlefit.studies.needle_placement import place_needles, simulate_fitted_draws
from needlefit.studies.observations import HeldOutPrediction

__all__ = ["project"]  # a fixture


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    with pytest.MonkeyPatch.context() as here:
        here.chdir(made(tmp_path_factory.mktemp("fitted")))
        job = load_study("needles", study(), Settings())
    (fold,) = job.folds
    problem = job.problem(fold)
    fit = minimize(problem, job.recipe, random_stream(1, "test"), Callbacks())
    return job, fold, fit


def place(fitted, draws=None, *args):
    job, fold, fit = fitted
    simulated = draws and simulate_fitted_draws(job.problem(fold), draws)
    rows = pd.DataFrame(place_needles(job.problem(fold), fold, fit, simulated, *args))
    return {
        name: SimpleNamespace(
            **part.iloc[0],
            curves={
                curve: some[["x_mm", "y_mm", "z_mm"]].to_numpy() for curve, some in part.groupby("curve")
            },
        )
        for name, part in rows.groupby("insertion")
    }


def test_every_needle_is_in_the_world_of_its_dataset(fitted):
    job, placed = fitted[0], place(fitted)
    assert {name: one.role for name, one in placed.items()} == {
        "needle-1": "tune", "needle-2": "tune", "needle-3": "validate", "needle-4": "validate"
    }  # fmt: skip
    for n, (name, one) in enumerate(sorted(placed.items())):
        insertion = next(i for i in job.dataset.insertions if i.id == name)
        assert_allclose(one.curves["measured"], insertion.centerline, atol=1e-9)
        assert arc_length(one.curves["fitted"])[-1] == pytest.approx(needles.DEPTHS[n], rel=1e-3)
        assert_allclose(one.curves["fitted"][-1], insertion.centerline[-1], atol=0.02)  # the truth is known
        assert one.diameter_mm == 1.27


def test_the_band_of_a_fitted_needle_is_that_of_the_needles_of_its_draws(fitted):
    """The tip goes farther with every b: its percentiles are the tips of the percentiles of b."""
    job, _, fit = fitted
    theta, at = np.array(fit.theta), job.parameters.free.index("bevel_mm")

    def draw(factors):
        thetas = np.tile(theta, (len(factors), 1))
        thetas[:, at] += np.log(factors)
        return Draws(thetas, "importance")

    band = place(fitted, draw(np.linspace(0.9, 1.1, 400)))["needle-1"]
    assert band.band_source == "posterior"
    for end, b in (("low", 0.905), ("middle", 1.0), ("high", 1.095)):
        single = place(fitted, draw([b, b]))["needle-1"].curves
        assert np.abs(single["high"] - single["low"]).max() < 1e-12
        assert_allclose(band.curves[end][-1], single["middle"][-1], atol=2e-3)
    assert_allclose(band.curves["middle"], place(fitted)["needle-1"].curves["fitted"], atol=2e-3)
    doubtful = dataclasses.replace(draw([1.0, 1.1]), faults=("not certified",))
    assert place(fitted, doubtful)["needle-1"].band_source == ""


def test_the_band_of_a_held_out_needle_is_the_predicted_one(fitted):
    fold = fitted[1]
    insertion = next(one for one in fold.validate if one.id == "needle-3")
    x = np.linspace(0.0, insertion.points[-1, 0], 5)
    y = np.interp(x, *insertion.points.T[:2])
    rows = [
        {"x_mm": at, "measured_mm": height + 7.0,
         "low_95_mm": height + 6.0, "median_mm": height + 7.5, "high_95_mm": height + 9.0}
        for at, height in zip(x, y, strict=True)
    ]  # fmt: skip
    placed = place(fitted, None, [HeldOutPrediction("needle-3", {"bands": rows}, CountMetadata())])
    band = placed["needle-3"].curves
    assert placed["needle-3"].band_source == "predicted"
    assert_allclose(band["high"] - band["low"], np.tile([0.0, 3.0, 0.0], (5, 1)), atol=1e-9)
    assert_allclose(band["middle"][-1], insertion.centerline[-1] + [0, 0.5, 0], atol=1e-6)
    assert "low" not in placed["needle-4"].curves and "low" not in placed["needle-1"].curves


@pytest.mark.sweep
def test_the_files_of_a_run_lie_in_the_scan(project, tmp_path):
    world = run("needles", study(), Settings()).frames["needles"]
    file = project / "data" / "needles" / "dataset.toml"  # by a half turn about z and a shift
    motion = "lps_to_world = [[-1, 0, 0, 10], [0, -1, 0, 20], [0, 0, 1, 30]]"
    file.write_text(file.read_text().replace("[frame]", f"[frame]\n{motion}"))
    results = run("needles", study(), Settings())
    out = tmp_path / "slicer"
    write_needles(results.frames["needles"], results.origin_mark, out)
    names = sorted(path.name for path in out.iterdir())
    assert names == sorted(f"needle-{n}.mrk.json" for n in range(1, 5))
    measured, predicted, _, low, high = read_markups(out / "needle-3.mrk.json")
    assert [one.name for one in (measured, predicted)] == [
        "needle-3 measured (SYNTHETIC data)", "needle-3 predicted (SYNTHETIC data)"
    ]  # fmt: skip
    assert "95 % band, low" in low.name and "95 % band, high" in high.name
    assert read_markups(out / "needle-1.mrk.json")[1].name == "needle-1 fitted (SYNTHETIC data)"
    assert (measured.labels[0], measured.labels[-1]) == ("entry", "tip")
    third = world[world["insertion"] == "needle-3"]
    for curve, name in ((measured, "measured"), (predicted, "fitted")):
        there = third.loc[third["curve"] == name, ["x_mm", "y_mm", "z_mm"]].to_numpy()
        assert_allclose(curve.points, (there - [10, 20, 30]) * [-1, -1, 1], atol=1e-9)
