"""How the sampler runs: when it ends, what it goes on from, what it keeps, and when draws have converged."""

import math
import os
import resource
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from inference_cases import medium
from numpy.random import default_rng
from pytest import approx
from refusals import refusal
from sampling_cases import Known, draw, flat, gaussian, standard_errors, weighted
from scipy.signal import lfilter
from scipy.stats import truncnorm

from needlefit.errors import DataError
from needlefit.inference.fit import Callbacks
from needlefit.inference.parameters import Parameters
from needlefit.inference.sampling.interpolated_density import MAX_RMS_ERROR
from needlefit.inference.sampling.posterior import MAX_R_HAT, Posterior, load, save
from needlefit.inference.sampling.sample import compare_means, compute_autocorrelation_time, compute_r_hat

MEAN, COV = np.array([0.4, -0.2]), np.array([[0.04, 0.03], [0.03, 0.09]])
GAUSSIAN = Known(gaussian(COV, MEAN), half=2.0)
BEGIN = weighted(GAUSSIAN, MEAN)
#: 35 steps of 16 walkers, in blocks of 10, and then 5
SHORT = {"walkers": 16, "densities": 16 * 35 + 15, "independent_draws": 10**6}


# ---- when a run ends


def test_a_run_ends_once_it_has_the_draws_that_were_asked_for():
    got = draw(GAUSSIAN, BEGIN, independent_draws=2000)
    walkers, steps, _ = got.draws.shape
    assert got.faults == () and walkers == 64 and steps % 10 == 0 and steps * walkers < 20000
    assert got.ess.min() >= 2000 and got.r_hat.max() < MAX_R_HAT and got.burn_in == 0
    shorter = draw(GAUSSIAN, BEGIN, independent_draws=2000, densities=(steps - 10) * walkers)
    assert shorter.faults and np.array_equal(shorter.draws, got.draws[:, :-10])
    assert got.log_posterior.ravel() == approx(GAUSSIAN.log_density(flat(got)), abs=1e-12)
    assert np.all(np.abs(flat(got).mean(axis=0) - MEAN) < 4 * standard_errors(got))
    assert np.cov(flat(got).T) == approx(COV, rel=0.12)
    assert got.percentiles()["x0"] == approx(np.quantile(flat(got)[:, 0], [0.025, 0.16, 0.5, 0.84, 0.975]))


@pytest.mark.sweep
def test_a_gaussian_that_bounds_cut():
    """Its peak lies in a corner outside; of each coordinate a tail that falls from the bound is left."""
    known = Known(gaussian(np.eye(3), 1.5), 3, half=1.0)
    got = draw(known, weighted(known, np.ones(3)), independent_draws=4000, densities=200_000)
    x, tail = flat(got), truncnorm(-2.5, -0.5, loc=1.5)
    assert got.faults == () and np.all(np.abs(x) <= 1)
    assert np.all(np.abs(x.mean(axis=0) - tail.mean()) < 4 * standard_errors(got))
    assert x.std(axis=0) == approx(np.full(3, tail.std()), rel=0.05)


def test_a_budget_that_is_spent_marks_the_draws():
    seen = []
    counted = replace(GAUSSIAN, log_density=lambda x: seen.append(len(x)) or GAUSSIAN.log_density(x))
    steps = []
    got = draw(counted, BEGIN, Callbacks(step=lambda done, most: steps.append((done, most))), **SHORT)
    assert got.draws.shape == (16, 35, 2) and steps == [(n, 35) for n in range(1, 36)]
    assert sum(seen) <= SHORT["densities"]
    assert got.wanted == 10**6 and len(got.faults) >= 1 and "1000000" in got.faults[-1]
    assert not np.array_equal(got.draws, draw(GAUSSIAN, BEGIN, seed=2, **SHORT).draws)


# ---- interpolated densities, and parameters that are held


class Interpolation:
    """The density and 0.1 more, and how far it is off by what it says."""

    fixed, checked = False, 0

    def __init__(self, error):
        self.error = error

    def __call__(self, thetas):
        return GAUSSIAN.log_density(thetas) + 0.1

    def find_error(self, thetas):
        self.checked = len(thetas)
        return self.error


@pytest.mark.parametrize(("error", "off"), [(0.9 * MAX_RMS_ERROR, 0.1), (1.1 * MAX_RMS_ERROR, 0.0)])
def test_a_chain_by_interpolated_densities_is_made_again_if_they_err_too_much(error, off):
    nodes, count = Interpolation(error), 16 * 261
    begin = replace(BEGIN, interpolated=nodes)
    got = draw(GAUSSIAN, begin, walkers=16, densities=count, independent_draws=10**6)
    away = got.log_posterior.ravel() - GAUSSIAN.log_density(flat(got))
    assert np.median(away) == approx(off, abs=1e-12)  # but of a walker that never moved
    assert nodes.fixed and nodes.checked == 64


class Searched(Known):
    names = ("mu1_pa", "bevel_mm")


def test_parameters_that_are_held_are_independent_draws_of_their_prior():
    alpha = {"bounds": [-7, 9], "prior": {"mean": 1.0, "sd": 2.0}}
    parameters = Parameters.from_record(medium(1, alpha1=alpha))
    searched = Searched(GAUSSIAN.log_density, half=2.0)
    got = draw(SimpleNamespace(searched=searched, parameters=parameters), BEGIN, **SHORT)
    plain = draw(searched, BEGIN, **SHORT)
    assert got.names == parameters.free == ("mu1_pa", "alpha1", "bevel_mm")
    assert np.array_equal(got.draws[..., [0, 2]], plain.draws)
    held = got.draws[..., 1]
    assert (held.mean(), held.std()) == approx((1.0, 2.0), abs=0.3)
    for name, value in (("r_hat", 1.0), ("autocorrelation_time", 1.0), ("apart", 0.0)):
        assert getattr(got, name) == approx(np.insert(getattr(plain, name), 1, value))


# ---- failures


def test_failed_evaluations_have_no_density_and_are_counted():
    def holes(x):
        if np.any(x[:, 1] > 0.2):
            raise ArithmeticError
        return np.where(x[:, 0] > 0.7, math.nan, np.where(x[:, 1] < -0.7, math.inf, GAUSSIAN.log_density(x)))

    known = replace(GAUSSIAN, log_density=holes)
    got = draw(known, weighted(known, MEAN), **SHORT)
    assert got.failures > 0
    assert flat(got)[:, 0].max() <= 0.7 and flat(got)[:, 1].min() >= -0.7 and flat(got)[:, 1].max() <= 0.2


# ---- a run that is stopped


def test_a_stopped_run_has_the_draws_that_it_made():
    steps = 11
    asked = []  # it is asked once before the first step
    stop = Callbacks(stop=lambda: asked.append(0) or len(asked) > steps)
    got, whole = draw(GAUSSIAN, BEGIN, stop, **SHORT), draw(GAUSSIAN, BEGIN, **SHORT)
    assert got.interrupted and np.array_equal(got.draws, whole.draws[:, :steps])
    assert np.array_equal(got.log_posterior, whole.log_posterior[:, :steps])


@pytest.mark.skipif(os.name != "posix", reason="a limit on the size of files")
def test_draws_that_a_full_disk_cannot_keep_are_an_error(tmp_path):
    """Beyond a limit on the size of files a write fails, as on a full disk."""
    posterior, (soft, hard) = draw(GAUSSIAN, BEGIN, **SHORT), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (6000, hard))
    try:
        refusal(OSError, "", save, posterior, tmp_path / "posterior.nc")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


# ---- convergence of chains whose values are known


def autoregressive(memory, steps=4000):
    """Return series (N, 16) of unit variance whose autocorrelation is memory^t."""
    noise = default_rng(1).normal(size=(steps + 200, 16))
    return lfilter([math.sqrt(1 - memory**2)], [1, -memory], noise, axis=0)[200:]


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_autocorrelation_time_of_a_known_series(memory):
    time = compute_autocorrelation_time(autoregressive(memory))
    assert time == approx((1 + memory) / (1 - memory), rel=0.06)
    assert compute_r_hat(autoregressive(memory)) == approx(1.0, abs=2e-3)


def test_r_hat_by_hand():
    """Four parts of known means and variances."""
    noise = np.array([-1.0, 1.0, -1.0, 1.0])
    values = np.column_stack([np.tile(noise, 2), np.tile(noise, 2)])
    values[4:] += 0.5  # of both walkers: a drift
    means, n = np.array([0.0, 0.0, 0.5, 0.5]), 4
    expected = math.sqrt((n - 1) / n + means.var(ddof=1) / (n / (n - 1)))
    assert compute_r_hat(values) == approx(expected, rel=1e-12)
    assert compute_r_hat(np.zeros((3, 8))) == math.inf and compute_r_hat(np.zeros((8, 8))) == math.inf


def test_walkers_that_rest_or_stay_in_their_mode_are_seen():
    assert compute_autocorrelation_time(np.ones((100, 8))) == math.inf
    noise = autoregressive(0.0, 500)
    resting = np.tile(default_rng(3).normal(size=16), (500, 1))
    apart = noise + 20.0 * np.where(np.arange(16) < 8, -1.0, 1.0)  # each walker alone looks independent
    for values in (resting, apart):
        assert noise.size / compute_autocorrelation_time(values) < 2 * 16
    assert compute_r_hat(noise + 20.0 * np.resize([-1.0, 1.0], 16)) > 10  # odd walkers, even ones
    assert compute_r_hat(noise + np.linspace(0, 2, 500)[:, None]) > 1.05


def test_chains_are_compared_with_the_draws_by_importance():
    """Of draws of one density means lie within chance; shifted by a standard deviation they do not."""
    got = draw(GAUSSIAN, BEGIN)
    assert got.apart.shape == (2,) and got.apart.max() < 4.0
    shifted = replace(BEGIN, thetas=BEGIN.thetas + np.sqrt(COV[0, 0]) * np.eye(2)[0])
    far = compare_means(got, shifted)
    assert far[0] > 10.0 and far[1] < 4.0
    unknown = replace(shifted, k=2.0)
    assert compare_means(got, unknown).tolist() == [0.0, 0.0]


def met(**changed):
    """Draws that have converged, but for `changed`."""
    rng = default_rng(4)
    fine = Posterior(
        names=("x0", "x1"),
        draws=rng.normal(size=(8, 100, 2)),
        log_posterior=rng.normal(size=(8, 100)),
        acceptance_fraction=np.full(8, 0.7),
        r_hat=np.array([1.0, 1.019, 1.01]),
        autocorrelation_time=np.array([2.0, 1.5, 1.0]),
        wanted=400,
        burn_in=3,
        failures=2,
        apart=np.array([0.2, 0.4]),
    )
    return replace(fine, **changed)


def test_each_criterion_counts():
    assert met().faults == () and met().ess.tolist() == [400.0, 800 / 1.5, 800.0]
    broken = [
        met(r_hat=np.array([1.0, MAX_R_HAT, 1.0])),
        met(r_hat=np.array([1.0, 1.0, math.nan])),
        met(autocorrelation_time=np.array([1.0, 1.0, 2.01])),
        met(autocorrelation_time=np.array([1.0, math.inf, 1.0])),
        met(wanted=401),
        met(interrupted=True),
        met(apart=np.array([0.5, 5.1])),
    ]
    assert [len(one.faults) for one in broken] == [1] * len(broken)


# ---- the file


def test_the_file_reads_back_equal_and_has_equal_bytes(tmp_path):
    for posterior in (met(), draw(GAUSSIAN, BEGIN, **SHORT), met(r_hat=np.array([math.inf, 1.0, math.nan]))):
        for name in ("one.nc", "two.nc"):
            save(posterior, tmp_path / name)
        assert (tmp_path / "one.nc").read_bytes() == (tmp_path / "two.nc").read_bytes()
        back = load(tmp_path / "one.nc")
        arrays = ("draws", "log_posterior", "acceptance_fraction", "r_hat", "autocorrelation_time", "apart")
        for name in arrays:
            assert np.array_equal(getattr(back, name), getattr(posterior, name), equal_nan=True)
        for name in ("names", "wanted", "burn_in", "failures", "interrupted"):
            assert getattr(back, name) == getattr(posterior, name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.nc", "two.nc"]


@pytest.mark.filterwarnings(r"ignore:\sArviZ is:FutureWarning")  # once a day
def test_arviz_reads_the_draws(tmp_path):
    import arviz  # takes seconds, and every process of a parallel run imports this file

    save(met(), tmp_path / "posterior.nc")
    file = tmp_path / "posterior.nc"
    for data in (arviz.from_datatree(met().to_xarray()), arviz.from_netcdf(file, engine="h5netcdf")):
        table = arviz.summary(data, round_to="none")
        assert table["mean"].to_numpy() == approx(met().draws.mean(axis=(0, 1)), rel=1e-12)
        assert dict(data.posterior.sizes) == {"chain": 8, "draw": 100}


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "posterior.nc"
    save(met(), path)
    with h5py.File(path, "r+") as file:
        file.create_dataset("posterior/more", (10**6, 10**6), dtype="f8")  # never written
    refusal(DataError, r"posterior\.nc", load, path)
