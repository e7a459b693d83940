"""How the sampler runs: when it ends, what it refuses, what it keeps and goes on from."""

import math
import re
import warnings
from contextlib import nullcontext

import numpy as np
import pytest
import xarray
from inference_cases import Analytic, box
from refusals import refusal

from needlefit.errors import ConfigError, DataError, FitError
from needlefit.inference.fit import Callbacks
from needlefit.inference.sampling import posterior as convergence
from needlefit.inference.sampling import sample as sample_module
from needlefit.inference.sampling.log_density import Evaluator, approximate_by_laplace
from needlefit.inference.sampling.posterior import load, save
from needlefit.inference.sampling.sample import (
    INDEPENDENT,
    Snapshots,
    parse_moves,
    sample,
)
from needlefit.project.checkpoint import open_checkpoint
from needlefit.schemas.recipe import SampleRecord

MEAN, COV = np.array([0.4, -0.2]), np.array([[0.04, 0.03], [0.03, 0.09]])
PRECISION = np.linalg.inv(COV)


def gaussian(theta):
    r = theta - MEAN
    return float(-0.5 * r @ PRECISION @ r)


def settings(**changed):
    return SampleRecord(**{"ensembles": 4, "walkers": 8, "steps": 60, "check_interval": 20, **changed})


def stored(folder, note=print):
    return Snapshots(open_checkpoint(folder, True, {"n": 1}, note), "fold")


def draw(function=gaussian, callbacks=None, seed=1, kept=None, **changed):
    rng = np.random.default_rng(seed)
    return sample(box(function), (0.4, -0.2), settings(**changed), rng, callbacks, stored(kept))


@pytest.fixture(scope="module")
def long():
    return draw(steps=4000, check_interval=50, walkers=12)


def test_a_run_ends_when_the_rule_is_met_and_recovers_a_gaussian(long):
    assert long.converged and long.faults == ()
    found, steps = long.convergence, long.steps + long.burn_in
    assert steps < 4000 and steps % 50 == 0
    assert np.all(found.r_hat < 1.01) and long.steps > 50 * found.tau.max()
    assert min(found.ess_bulk.min(), found.ess_tail.min()) > 400
    shorter = draw(steps=steps - 50, check_interval=50, walkers=12)
    assert not shorter.converged  # one block less was not enough
    assert np.all(long.burn_in <= steps / 2)
    flat = long.draws.reshape(-1, 2)
    assert flat.mean(axis=0) == pytest.approx(MEAN, abs=0.02)
    assert np.cov(flat.T) == pytest.approx(COV, abs=0.01)
    low, middle, high = (long.percentiles()["x0"][k] for k in (0, 2, 4))
    assert (low, middle, high) == pytest.approx((0.4 - 0.392, 0.4, 0.4 + 0.392), abs=0.04)
    assert long.percentiles()["x0"] == pytest.approx(np.quantile(flat[:, 0], [0.025, 0.16, 0.5, 0.84, 0.975]))
    assert long.log_posterior[0, 0] == gaussian(long.draws[0, 0])


def test_runs_of_a_budget_do_not_depend_on_threads_and_begin_apart():
    short = draw()
    assert not short.converged and not short.interrupted
    assert short.steps + short.burn_in == 60 and short.burn_in <= 30
    assert any("autocorrelation" in fault for fault in short.faults)
    assert re.findall(r"\d+", draw(ensembles=1).faults[0]) == ["1", "4"]
    first, second = draw(), draw(callbacks=Callbacks(jobs=2))
    assert np.array_equal(first.draws, second.draws)
    assert not np.array_equal(first.draws, draw(seed=2).draws)
    draws = draw(steps=2).draws
    centres = draws.mean(axis=1)
    assert len(np.unique(centres[:, 0])) == 4 and np.ptp(centres[:, 0]) > 0.05


def test_ensembles_with_equal_starts_differ(monkeypatch):
    """Their starting points would hide it if all of them drew the same random numbers after that."""

    def same(*arguments):
        state = whole(*arguments)
        one, known = state.coordinates[:1], state.log_density[:1]
        return type(state)(np.repeat(one, 4, axis=0), np.repeat(known, 4, axis=0), state.random)

    whole = sample_module.initialize_walkers
    monkeypatch.setattr(sample_module, "initialize_walkers", same)
    draws = draw(steps=40).draws
    for one in range(4):
        for other in range(one):
            assert np.mean(draws[one] == draws[other]) < 0.5


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
    values = {0.0: 1.5, 0.5: math.nan, 1.0: math.inf, 1.5: -math.inf}
    evaluator = Evaluator(box(lambda theta: values[theta[0]]), 1)
    thetas = np.array([[0.0, 0], [0.5, 0], [1.0, 0], [1.5, 0], [2.5, 0]])
    assert evaluator(thetas).tolist() == [1.5, *[-math.inf] * 4]
    assert evaluator.failures == 2 and evaluator.failed == [[(0.5, 0.0), (1.0, 0.0)]]


def test_the_laplace_approximation_of_a_gaussian_is_the_gaussian_within_its_bounds():
    """Its precision, and that of a uniform density as wide as the bounds: 12 / width^2."""
    lower, upper = np.array([-1.0, -4.0]), np.array([3.0, 2.0])

    def density(thetas):
        return np.array([gaussian(theta) for theta in thetas])

    found = approximate_by_laplace(density, MEAN, lower, upper)
    exact = np.linalg.inv(PRECISION + np.diag(12 / (upper - lower) ** 2))
    assert found.centre == pytest.approx(MEAN, abs=1e-12)
    assert found.axes @ found.axes.T == pytest.approx(exact, rel=1e-6)
    at_bound = approximate_by_laplace(density, upper, lower, upper)
    assert at_bound.centre == pytest.approx(upper - 1e-3 * (upper - lower), abs=1e-12)


def test_bugs_bounds_and_moves():
    def bug(theta):
        raise KeyError("mu7_pa")

    refusal(KeyError, "", draw, bug)
    got = draw(lambda theta: 0.0)
    assert np.all(np.abs(got.draws) <= 2)
    refusal(FitError, "no starting points", draw, lambda theta: -math.inf)
    for moves in ("hop", "de+de", "0*de", "de*snooker", ""):
        refusal(ConfigError, r"sample\.moves", draw, moves=moves)
    assert parse_moves("stretch") == {"stretch": 1.0}
    assert parse_moves("de+stretch") == {"de": 0.5, "stretch": 0.5}
    assert parse_moves("3 * de + 1*stretch") == {"de": 0.75, "stretch": 0.25}


def stopping_after(count):
    asked = []

    def stop():
        asked.append(0)
        return len(asked) > count

    return stop


def test_a_stop_finishes_the_step_and_keeps_equal_lengths():
    steps = []
    stop = stopping_after(52)
    got = draw(callbacks=Callbacks(stop=stop, step=lambda done, total: steps.append((done, total))))
    assert got.interrupted and got.draws.shape == (4, got.steps * 8, 2)
    assert steps[-1] == (got.steps + got.burn_in, 60) and 40 < steps[-1][0] < 60
    assert "interrupted" in got.faults[0]


@pytest.mark.parametrize("stopped", [1, 21, 37, 59])
def test_a_run_resumes_from_its_snapshots_to_the_same_bytes(tmp_path, stopped):
    save(draw(), tmp_path / "whole.nc")
    stop = Callbacks(stop=stopping_after(stopped))
    with pytest.raises(FitError, match="nothing to keep") if stopped == 1 else nullcontext():
        draw(callbacks=stop, kept=tmp_path / "kept")
    save(draw(kept=tmp_path / "kept"), tmp_path / "again.nc")
    assert (tmp_path / "whole.nc").read_bytes() == (tmp_path / "again.nc").read_bytes()
    assert [
        row["block"] for row in open_checkpoint(tmp_path / "kept", True, {"n": 1}).rows("posterior of fold")
    ] == [0, 1, 2]


@pytest.mark.parametrize("stopped", [5, 11, 40])
def test_adaptation_is_restored_from_snapshots(tmp_path, monkeypatch, stopped):
    monkeypatch.setattr(sample_module, "ADAPTATION_STEPS", (10, 25))
    save(draw(moves=INDEPENDENT), tmp_path / "whole.nc")
    draw(moves=INDEPENDENT, callbacks=Callbacks(stop=stopping_after(2 * stopped)), kept=tmp_path / "kept")
    save(draw(moves=INDEPENDENT, callbacks=Callbacks(jobs=2), kept=tmp_path / "kept"), tmp_path / "again.nc")
    assert (tmp_path / "whole.nc").read_bytes() == (tmp_path / "again.nc").read_bytes()


@pytest.mark.parametrize("damage", ["cut", "flipped", "lost"])
def test_a_damaged_snapshot_is_set_aside_and_sampled_again(tmp_path, damage):
    whole, lines = draw(kept=tmp_path), []
    (file,) = tmp_path.glob("*.jsonl")
    before = file.read_bytes()
    first, second, third = (line for line in before.split(b"\n") if line)
    spoiled = {"cut": second[:200], "flipped": second.replace(b"A", b"B", 1), "lost": b""}[damage]
    file.write_bytes(b"\n".join((first, spoiled, third, b"")))  # the third is of no use then
    kept = stored(tmp_path, lines.append)
    again = sample(box(gaussian), (0.4, -0.2), settings(), np.random.default_rng(1), None, kept)
    assert np.array_equal(again.draws, whole.draws)
    asides = list(tmp_path.glob("*.damaged-1"))
    assert len(lines) == len(asides) == (damage != "lost")
    assert [line for line in file.read_bytes().split(b"\n") if line] == [first, third, second, third]
    assert np.array_equal(draw(kept=tmp_path).draws, whole.draws)


def test_too_few_walkers_nothing_free_and_a_file_that_is_no_posterior_are_errors(tmp_path):
    with pytest.raises(ConfigError, match="walkers"):
        sample(box(gaussian, 5), (0.0,) * 5, settings(walkers=8), np.random.default_rng(1))
    nothing = Analytic(gaussian, np.empty(0), np.empty(0))
    refusal(ConfigError, "nothing is free", lambda: sample(nothing, (), settings(), np.random.default_rng(1)))
    (tmp_path / "no.nc").write_text("no netCDF")
    refusal(DataError, r"no\.nc", load, tmp_path / "no.nc")


def test_the_file_is_inference_data_and_reads_back_equal(tmp_path):
    posterior = draw()
    save(posterior, tmp_path / "posterior.nc")
    back = load(tmp_path / "posterior.nc")
    assert np.array_equal(back.draws, posterior.draws)
    assert np.array_equal(back.log_posterior, posterior.log_posterior)
    assert np.array_equal(back.r_hat, posterior.r_hat) and back.names == posterior.names
    assert (back.walkers, back.moves, back.faults) == (8, posterior.moves, posterior.faults)
    length = posterior.steps * 8
    with xarray.open_dataset(tmp_path / "posterior.nc", group="posterior", engine="h5netcdf") as group:
        assert group["x0"].dims == ("chain", "draw") and group["x0"].shape == (4, length)
        assert group.attrs["state"].startswith("NOT CONVERGED: ")
    with xarray.open_dataset(tmp_path / "posterior.nc", group="sample_stats", engine="h5netcdf") as group:
        assert group["lp"].shape == (4, length) and group["acceptance_rate"].shape == (4,)
    with xarray.open_dataset(tmp_path / "posterior.nc", group="convergence", engine="h5netcdf") as group:
        assert list(group["quantity"].to_numpy()) == [
            *("x0", "x1", "direction 1", "direction 2", "log posterior")
        ]
        assert group["ess_tail"].dims == ("chain", "quantity") and group["r_hat"].dims == ("quantity",)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["posterior.nc"]


def test_points_beyond_bounds_come_back_and_ensembles_begin_near_the_best(monkeypatch):
    lower, upper = np.array([-1.0, 2.0]), np.array([3.0, 5.0])
    beyond = np.array([[0.5, 3.0], [4.0, 1.5], [-2.0, 6.0], [8.5, 9.0]])
    found = sample_module._reflect_at_bounds(beyond, lower, upper)
    assert found == pytest.approx(np.array([[0.5, 3.0], [2.0, 2.5], [0.0, 4.0], [0.5, 3.0]]))
    densities = np.array(
        [-20.0, -20.0 - sample_module.MAX_LOG_DENSITY_GAP, -21.0 - sample_module.MAX_LOG_DENSITY_GAP]
    )
    ends = np.arange(6.0).reshape(3, 2)
    assert sample_module._select_plausible(lambda _: densities, ends).tolist() == ends[:2].tolist()
    monkeypatch.setattr(sample_module, "ADAPTATION_STEPS", (10, 30))
    assert draw(moves=INDEPENDENT).burn_in == 30
    assert draw(moves=INDEPENDENT, steps=59).burn_in < 30  # the second would leave less than it takes


# ---- convergence: R-hat and independent draws of chains whose values are known


@pytest.fixture(scope="module")
def arviz():
    """Imported here: it takes seconds, and every process of a parallel run imports this file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # arviz announces its next version once a day
        import arviz
    return arviz


def autoregressive(memory, shape, seed=1):
    """Return series (E, S, W) of unit variance whose autocorrelation is memory^t."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=shape)
    series = np.empty(shape)
    series[:, 0] = noise[:, 0]
    for t in range(1, shape[1]):
        series[:, t] = memory * series[:, t - 1] + math.sqrt(1 - memory**2) * noise[:, t]
    return series


def chains(seed=2, drift=0.0):
    series = autoregressive(0.8, (4, 2000, 1), seed)[..., 0]
    return series + drift * np.arange(4)[:, None]


@pytest.mark.parametrize("drift", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("form", [lambda x: x, np.exp, lambda x: x**3])
def test_r_hat_is_that_of_arviz(drift, form, arviz):
    drawn = form(chains(drift=drift))
    assert convergence.r_hat(drawn) == pytest.approx(float(arviz.rhat(drawn, method="rank")), rel=1e-12)


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_autocorrelation_time_of_a_known_series(memory):
    """tau = (1 + memory) / (1 - memory)."""
    times = convergence.autocorrelation_times(autoregressive(memory, (3, 6000, 8)))
    assert times.mean() == pytest.approx((1 + memory) / (1 - memory), rel=0.1)


def test_independent_draws_agree_with_those_of_arviz(arviz):
    # Of one walker an ensemble is a chain; the estimates of both windows differ by a few percent.
    series = autoregressive(0.8, (4, 20000, 1))
    found = convergence.assess_convergence(series[..., None], series, ["x"])
    theirs = {kind: float(arviz.ess(series[..., 0], method=kind)) for kind in ("bulk", "tail")}
    assert found.ess_bulk.sum(axis=0)[0] == pytest.approx(theirs["bulk"], rel=0.1)
    assert found.ess_tail.sum(axis=0)[0] == pytest.approx(theirs["tail"], rel=0.15)
    found = convergence.assess_convergence(
        autoregressive(0.5, (4, 3000, 16))[..., None], np.zeros((4, 3000, 16)), ["x"]
    )
    assert found.ess_bulk[:, 0] == pytest.approx(np.full(4, 16 * 3000 / 3), rel=0.1)
    series = autoregressive(0.5, (3, 400, 5), 6) + 0.3 * np.arange(3)[:, None, None]
    found = convergence.assess_convergence(series[..., None], np.zeros((3, 400, 5)), ["x"])
    assert found.r_hat[0] == pytest.approx(float(arviz.rhat(series.reshape(3, -1), method="rank")), rel=1e-12)


def test_convergence_is_checked_along_the_stiff_direction():
    """Neither parameter shows that the ensembles disagree about the difference of both."""
    sloppy = autoregressive(0.0, (4, 500, 8), 3)
    stiff = 0.01 * autoregressive(0.0, (4, 500, 8), 4) + 0.01 * np.arange(4)[:, None, None]
    thetas = np.stack([sloppy + stiff, sloppy - stiff], axis=3)
    found = convergence.assess_convergence(thetas, autoregressive(0.0, (4, 500, 8), 5), ["a", "b"])
    assert found.quantities == ("a", "b", "direction 1", "direction 2", "log posterior")
    by_name = dict(zip(found.quantities, found.r_hat, strict=True))
    assert by_name["direction 1"] > 1.2 > 1.01 > max(by_name["a"], by_name["b"])
    assert any("direction 1" in fault for fault in found.faults)


def met(**changed):
    """A single quantity of four ensembles for which the rule is met, but for `changed`."""
    fine = {
        "quantities": ("x",),
        "r_hat": np.array([1.009]),
        "tau": np.array([[9.9], [9.0], [9.0], [9.0]]),
        "ess_bulk": np.array([[401.0], [500.0], [500.0], [500.0]]),
        "ess_tail": np.array([[401.0], [500.0], [500.0], [500.0]]),
        "steps": 500,
    }
    return convergence.Convergence(**{**fine, **changed})


def test_each_clause_of_the_rule_counts():
    assert met().faults == ()
    broken = [
        met(r_hat=np.array([1.01])),
        met(r_hat=np.array([math.nan])),
        met(tau=np.array([[10.0], [9.0], [9.0], [9.0]])),
        met(tau=np.array([[math.inf], [9.0], [9.0], [9.0]])),
        met(ess_bulk=np.array([[401.0], [400.0]])),
        met(ess_tail=np.array([[400.0], [500.0]])),
        met(tau=np.array([[9.9], [9.0], [9.0]])),
    ]
    assert [len(one.faults) for one in broken] == [1] * len(broken)
    same = np.random.default_rng(2).normal(size=(4, 4000))
    assert math.isnan(convergence.r_hat(same[:1])) and math.isnan(convergence.r_hat(same[:, :3]))
    assert convergence.r_hat(np.ones((4, 100))) == 1.0
