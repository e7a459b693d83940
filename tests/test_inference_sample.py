import math
from dataclasses import replace

import numpy as np
import pytest
import xarray
from inference_cases import TRUTH as VALUES
from inference_cases import Analytic, box, insertion, measure, medium, problem, recipe

from needlefit.errors import ConfigError, DataError, FitError
from needlefit.inference import sample as sample_module
from needlefit.inference.convergence import r_hat
from needlefit.inference.posterior import load, save
from needlefit.inference.sample import sample
from needlefit.inference.starts import Watch
from needlefit.project.records.recipe import SampleRecord

MEAN, COV = np.array([0.4, -0.2]), np.array([[0.04, 0.03], [0.03, 0.09]])
PRECISION = np.linalg.inv(COV)


def gaussian(theta):
    r = theta - MEAN
    return float(-0.5 * r @ PRECISION @ r)


def settings(**changed):
    return SampleRecord(**{"ensembles": 4, "walkers": 20, "steps": 60, "burn_in": 30, **changed})


def draw(function=gaussian, watch=None, seed=1, **changed):
    return sample(box(function), (0.4, -0.2), settings(**changed), np.random.default_rng(seed), watch)


@pytest.fixture(scope="module")
def long():
    return draw(steps=2500, burn_in=200, walkers=12)


def test_a_gaussian_is_recovered(long):
    flat = long.draws.reshape(-1, 2)
    assert flat.mean(axis=0) == pytest.approx(MEAN, abs=0.01)
    assert np.cov(flat.T) == pytest.approx(COV, abs=0.006)
    low, sixteenth, middle, eightyfourth, high = long.percentiles()["x0"]
    assert (low, middle, high) == pytest.approx((0.4 - 0.392, 0.4, 0.4 + 0.392), abs=0.03)
    assert (sixteenth, eightyfourth) == pytest.approx((0.2, 0.6), abs=0.02)
    assert long.log_posterior[0, 0] == gaussian(long.draws[0, 0])


def test_long_chains_that_agree_have_converged(long):
    assert long.converged and long.faults == ()
    assert np.all((long.acceptance > 0.6) & (long.acceptance < 0.8))  # stretch move in two dimensions
    assert np.all((long.autocorrelation_time > 10) & (long.autocorrelation_time < 50))
    assert np.all(long.r_hat < 1.01)


def test_short_chains_say_that_they_have_not_converged():
    short = draw()
    assert not short.converged
    assert any("autocorrelation" in fault for fault in short.faults)
    assert draw(ensembles=1).faults[0].startswith("a single ensemble")


def test_ensembles_on_two_separate_hills_show_in_r_hat():
    hills = np.stack([np.random.default_rng(k).normal(at, 0.05, 500) for k, at in enumerate((-1.5, 1.5))])
    assert r_hat(hills) > 1.5


def test_r_hat_of_known_chains():
    rng = np.random.default_rng(2)
    same = rng.normal(size=(4, 4000))
    assert r_hat(same) == pytest.approx(1.0, abs=0.005)
    assert r_hat(np.exp(20 * same)) == pytest.approx(r_hat(same), abs=0.01)  # only ranks matter
    wider = same * np.array([[1], [1], [1], [3]])
    assert r_hat(wider) > 1.05  # equal means, another width
    drifting = same + np.linspace(0, 3, 4000)
    assert r_hat(drifting) > 1.2  # the halves disagree
    assert math.isnan(r_hat(same[:1])) and math.isnan(r_hat(same[:, :3]))
    assert r_hat(np.ones((4, 100))) == 1.0


def test_the_draws_do_not_depend_on_the_number_of_threads():
    first, second = draw(), draw(watch=Watch(jobs=2))
    assert np.array_equal(first.draws, second.draws)
    assert not np.array_equal(first.draws, draw(seed=2).draws)


def test_ensembles_differ_and_begin_apart():
    draws = draw(burn_in=0, steps=2).draws
    centres = draws.mean(axis=1)
    assert len(np.unique(centres[:, 0])) == 4 and np.ptp(centres[:, 0]) > 0.05


def test_ensembles_begun_in_one_place_go_their_own_ways(monkeypatch):
    """Their starting points would hide it if all of them drew the same random numbers after that."""
    monkeypatch.setattr(
        sample_module, "_walkers", lambda *_: np.random.default_rng(0).uniform(-1, 1, (20, 2))
    )
    draws = draw(burn_in=0, steps=20).draws
    for one in range(4):
        for other in range(one):
            assert not np.array_equal(draws[one], draws[other])
            assert np.mean(draws[one, 20:] == draws[other, 20:]) < 0.5


def test_nan_infinity_and_failed_solves_have_no_density_and_are_counted():
    def holes(theta):
        if theta[0] > 0.7:
            return float("nan")
        if theta[1] > 0.2:
            raise ArithmeticError
        return float("inf") if theta[1] < -0.7 else gaussian(theta)

    got = draw(holes)
    assert got.failures > 0
    assert got.draws[..., 0].max() <= 0.7 and got.draws[..., 1].max() <= 0.2
    assert got.draws[..., 1].min() >= -0.7


def test_a_bug_is_raised():
    def bug(theta):
        raise KeyError("mu7_pa")

    with pytest.raises(KeyError):
        draw(bug)


def test_draws_stay_within_the_bounds():
    got = draw(lambda theta: 0.0)
    assert np.all(np.abs(got.draws) <= 2)


def test_a_density_that_is_zero_everywhere_is_an_error():
    with pytest.raises(FitError, match="no starting points"):
        draw(lambda theta: -math.inf)


def test_a_stop_finishes_the_step_and_keeps_equal_lengths():
    asked = []

    def stop():
        asked.append(0)
        return len(asked) > 50

    steps = []
    got = draw(watch=Watch(stop=stop, step=lambda done, total: steps.append((done, total))))
    assert got.interrupted and got.steps == 20 and got.draws.shape == (4, 20 * 20, 2)
    assert steps[-1] == (50, 90)
    assert "interrupted" in got.faults[0]
    whole = draw()
    assert np.array_equal(whole.draws[:, : 20 * 20], got.draws)


def test_a_stop_in_the_burn_in_leaves_nothing():
    with pytest.raises(FitError, match="burn-in"):
        draw(watch=Watch(stop=lambda: True))


def test_too_few_walkers_and_nothing_free_are_errors():
    with pytest.raises(ConfigError, match="walkers"):
        sample(box(gaussian, 5), (0.0,) * 5, settings(walkers=8), np.random.default_rng(1))
    nothing = Analytic(gaussian, np.empty(0), np.empty(0))
    with pytest.raises(ConfigError, match="nothing is free"):
        sample(nothing, (), settings(), np.random.default_rng(1))


def test_the_file_is_inference_data_and_reads_back_equal(tmp_path):
    posterior = draw()
    save(posterior, tmp_path / "posterior.nc")
    back = load(tmp_path / "posterior.nc")
    assert np.array_equal(back.draws, posterior.draws)
    assert np.array_equal(back.log_posterior, posterior.log_posterior)
    assert np.array_equal(back.r_hat, posterior.r_hat) and back.names == posterior.names
    assert (back.walkers, back.faults) == (posterior.walkers, posterior.faults)
    with xarray.open_dataset(tmp_path / "posterior.nc", group="posterior", engine="h5netcdf") as group:
        assert group["x0"].dims == ("chain", "draw") and group["x0"].shape == (4, 1200)
    with xarray.open_dataset(tmp_path / "posterior.nc", group="sample_stats", engine="h5netcdf") as group:
        assert group["lp"].shape == (4, 1200)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["posterior.nc"]


def test_equal_posteriors_give_equal_bytes(tmp_path):
    for name in ("a.nc", "b.nc"):
        save(draw(), tmp_path / name)
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_what_is_no_posterior_is_refused(tmp_path):
    (tmp_path / "no.nc").write_text("no netCDF")
    with pytest.raises(DataError, match=r"no\.nc"):
        load(tmp_path / "no.nc")


def test_the_needle_posterior_covers_the_truth():
    record = medium(1, mu1_pa={"fixed": 3e5})
    p = problem(record, [measure(VALUES, record, insertion(30.0), 31)])
    best = p.parameters.theta(VALUES)
    got = sample(p, best, settings(steps=60, walkers=8, ensembles=2), np.random.default_rng(3), Watch(jobs=2))
    low, high = got.percentiles((0.5, 99.5))["bevel_mm"]
    assert low < VALUES["bevel_mm"] < high < 0.5
    assert replace(got, interrupted=True).faults and recipe().sample.ensembles == 4
