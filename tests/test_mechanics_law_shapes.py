"""Every law with all its shape parameters: kernel, lanes and derivatives against the reference."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mechanics_cases import NEEDLE, assert_close, assert_derivatives
from plugin_cases import install, plugin_folder

from needlefit.errors import ModelError
from needlefit.mechanics import reference
from needlefit.mechanics.batch import Batch, linearize_steps, simulate_batches
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.laws import LAWS, Numbers, TissueLaw
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue

STEPS = (Step(11.0, Bevel(0.1), Controls(0.5)), Step(17.3, Bevel(0.1, -1), Controls(0.5)))
LAYERS = 2


@pytest.fixture(params=[*LAWS.names(), "logarithmic"])
def law(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Each law of the package, and the plugin's, which has two shape parameters and a table."""
    if request.param in LAWS.names():
        yield request.param
        return
    with plugin_folder(install(tmp_path), monkeypatch):
        yield request.param


def make_tissue(law: str, seed: int) -> Tissue:
    """Thin layers, which the base compresses by a tenth: every shape parameter moves the needle."""
    shape = [np.random.default_rng(seed).uniform(*one.usual, LAYERS) for one in LAWS[law].parameters]
    return Tissue([0.4, 2.0], dict(zip(LAWS[law].shape_names, shape, strict=True)), [7.3], 5.0, 0.2, law)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_kernel_equals_the_reference(law: str, seed: int) -> None:
    tissue = make_tissue(law, seed)
    fast, slow = (solve(NEEDLE, tissue, STEPS) for solve in (simulate_steps, reference.simulate_steps))
    assert_close(fast, slow)


@pytest.mark.parametrize("seed", [3, 4])
def test_derivatives_equal_complex_steps(law: str, seed: int) -> None:
    tissue, rules = make_tissue(law, seed), ModelOptions(tolerance=1e-10)
    _, found = linearize_steps(NEEDLE, tissue, STEPS, rules, wrt=("mu", "shape"))
    expected = [f"{name}{layer}" for name in LAWS[law].shape_names for layer in range(1, LAYERS + 1)]
    assert found.names == ("mu1", "mu2", *expected)
    assert np.abs(found.u).max(axis=0).min() > 1e-6
    assert_derivatives(found, NEEDLE, tissue, STEPS, rules, rtol=1e-6)


def test_lanes_equal_single_needles(law: str) -> None:
    tissue, rng, sets = make_tissue(law, 5), np.random.default_rng(6), 11
    bounds = [one.usual for one in LAWS[law].parameters]
    shape = np.array([rng.uniform(*one, (sets, LAYERS)) for one in bounds]).reshape(-1, sets, LAYERS)
    batch = Batch(
        NEEDLE, tissue, STEPS, mu=rng.uniform(0.3, 3.0, (sets, LAYERS)), shape=np.moveaxis(shape, 0, 1)
    )
    (shapes,) = simulate_batches([batch])
    assert shapes.converged.all()
    for i in range(sets):
        np.testing.assert_allclose(shapes[i].u, simulate_steps(*batch.pick(i)).u, rtol=0, atol=1e-7)
    np.testing.assert_allclose(shapes[0].u, reference.simulate_steps(*batch.pick(0)).u, rtol=0, atol=1e-7)


def test_a_set_outside_of_the_laws_bounds_is_no_number(law: str) -> None:
    tissue = make_tissue(law, 7)
    shape = np.repeat(tissue.shape[None], 3, axis=0)
    for number, one in enumerate(LAWS[law].parameters):
        if np.isfinite(one.bounds[0]):
            shape[1, number, 1] = one.bounds[0] - 0.1
    outside = bool(np.any(shape[1] != shape[0]))
    (shapes,) = simulate_batches([Batch(NEEDLE, tissue, STEPS, shape=shape)])
    assert shapes.converged.tolist() == [True, not outside, True]
    np.testing.assert_array_equal(shapes.u[0], shapes.u[2])


@pytest.mark.parametrize("turned", [False, True])
def test_numbers_out_of_bounds_fail_alone_whatever_the_order(turned: bool) -> None:
    order = [1, 0] if turned else [0, 1]
    offset = np.array([0.1, 1e16])[order]
    (shapes,) = simulate_batches([Batch(NEEDLE, make_tissue("ogden", 1), STEPS, offset=offset)])
    assert shapes.status[order].tolist() == [0, 3]


def test_alpha_alone_and_a_law_without_shape_parameters(monkeypatch):
    alpha = np.ones((3, LAYERS))
    assert Batch(NEEDLE, make_tissue("ogden", 1), STEPS, alpha=alpha).shape.shape == (3, 1, LAYERS)
    for law, more in (("gent", {}), ("two_term_ogden", {}), ("ogden", {"shape": np.ones((3, 1, LAYERS))})):
        with pytest.raises(ModelError, match="alpha"):
            Batch(NEEDLE, make_tissue(law, 1), STEPS, alpha=alpha, **more)
    # exp(2 (1 - lambda)) is no sum of powers; a table and the reference agree.

    class Exponential(TissueLaw):
        name, label = "exponential", "exponential foundation"

        def k(self, stretch: Numbers) -> Numbers:
            return 3 * np.exp(2 * (1 - stretch))

    assert "exponential" not in LAWS.names()
    monkeypatch.setitem(LAWS._builtin, "exponential", Exponential())
    tissue = Tissue([0.4, 2.0], boundaries=[7.3], thickness=5.0, law="exponential")
    fast, slow = (solve(NEEDLE, tissue, STEPS) for solve in (simulate_steps, reference.simulate_steps))
    np.testing.assert_allclose(fast.u, slow.u, rtol=0, atol=1e-7)
