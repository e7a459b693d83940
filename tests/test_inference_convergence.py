"""R-hat and independent draws of chains whose values are known, beside another implementation."""

import math
import warnings

import numpy as np
import pytest

from needlefit.inference.sampling.convergence import (
    Convergence,
    assess_convergence,
    autocorrelation_times,
    r_hat,
)


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
    assert r_hat(drawn) == pytest.approx(float(arviz.rhat(drawn, method="rank")), rel=1e-12)


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_autocorrelation_time_of_a_known_series(memory):
    """tau = (1 + memory) / (1 - memory)."""
    times = autocorrelation_times(autoregressive(memory, (3, 6000, 8)))
    assert times.mean() == pytest.approx((1 + memory) / (1 - memory), rel=0.1)


def test_independent_draws_agree_with_those_of_arviz(arviz):
    """Of one walker an ensemble is a chain; the estimates of both windows differ by a few percent."""
    series = autoregressive(0.8, (4, 20000, 1))
    found = assess_convergence(series[..., None], series, ["x"])
    theirs = {kind: float(arviz.ess(series[..., 0], method=kind)) for kind in ("bulk", "tail")}
    assert found.ess_bulk.sum(axis=0)[0] == pytest.approx(theirs["bulk"], rel=0.1)
    assert found.ess_tail.sum(axis=0)[0] == pytest.approx(theirs["tail"], rel=0.15)


def test_walkers_that_are_independent_add_up():
    found = assess_convergence(autoregressive(0.5, (4, 3000, 16))[..., None], np.zeros((4, 3000, 16)), ["x"])
    assert found.ess_bulk[:, 0] == pytest.approx(np.full(4, 16 * 3000 / 3), rel=0.1)


def test_the_walkers_of_an_ensemble_are_one_chain_step_by_step(arviz):
    series = autoregressive(0.5, (3, 400, 5), 6) + 0.3 * np.arange(3)[:, None, None]
    found = assess_convergence(series[..., None], np.zeros((3, 400, 5)), ["x"])
    assert found.r_hat[0] == pytest.approx(float(arviz.rhat(series.reshape(3, -1), method="rank")), rel=1e-12)


def test_convergence_is_checked_along_the_stiff_direction():
    """Neither parameter shows that the ensembles disagree about the difference of both."""
    sloppy = autoregressive(0.0, (4, 500, 8), 3)
    stiff = 0.01 * autoregressive(0.0, (4, 500, 8), 4) + 0.01 * np.arange(4)[:, None, None]
    thetas = np.stack([sloppy + stiff, sloppy - stiff], axis=3)
    found = assess_convergence(thetas, autoregressive(0.0, (4, 500, 8), 5), ["a", "b"])
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
    return Convergence(**{**fine, **changed})


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


def test_r_hat_of_known_chains():
    rng = np.random.default_rng(2)
    same = rng.normal(size=(4, 4000))
    assert r_hat(same) == pytest.approx(1.0, abs=0.005)
    wider = same * np.array([[1], [1], [1], [3]])
    assert r_hat(wider) > 1.05  # equal means, another width
    drifting = same + np.linspace(0, 3, 4000)
    assert r_hat(drifting) > 1.2  # the halves disagree
    assert math.isnan(r_hat(same[:1])) and math.isnan(r_hat(same[:, :3]))
    assert r_hat(np.ones((4, 100))) == 1.0
