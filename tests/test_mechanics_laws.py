"""Tissue laws: what each says by hand, and how truly the kernel's polynomial says it."""

from ctypes import c_double, c_int64, c_void_p
from typing import NamedTuple

import numpy as np
import pytest
import reference_solver
from mechanics_cases import NEEDLE, assert_derivatives, draw_shape
from plugin_cases import install, plugin_folder
from pytest import approx

from needlefit import (
    Bevel,
    Controls,
    Guide,
    ModelOptions,
    Step,
    Tissue,
    compute_stress,
    simulate,
    simulate_steps,
)
from needlefit.errors import ModelError
from needlefit.mechanics import native
from needlefit.mechanics.batch import linearize_steps
from needlefit.mechanics.laws import LAWS, TissueLaw
from needlefit.mechanics.packing import compile_law, differentiate_law

H = 1e-30  # of complex steps

REST = np.zeros(1)


class EvaluatedLaw(NamedTuple):
    """A layer's law at |e| (K,) mm, as the kernel evaluates it; MPa and mm."""

    k: np.ndarray
    tangent: np.ndarray  # d(k e)/de
    by_shape: np.ndarray  # dk/dp of a shape parameter
    limit: float  # the |e| up to which the polynomial holds
    curvature: float  # a Newton step leaves at most about this times its increment squared, 1 / mm
    series: np.ndarray  # of k in |e|


def evaluated(tissue, layer=0, e=REST, number=0):
    """The law of one layer at |e| = `e`, mm, as the kernel has it, by the shape parameter of a number."""
    shape = tissue.shape[:, layer : layer + 1]
    parts, slopes = compile_law(tissue.law, shape), differentiate_law(tissue.law, shape)
    law, size = np.concatenate(parts, axis=1)[0], np.ascontiguousarray(e, dtype=np.float64)
    by = np.broadcast_to(slopes, (1, len(shape), len(law)))[0, number].copy() if len(shape) else None
    found, about = np.zeros((3, len(size))), np.empty(2 + native.SERIES_TERMS)
    arrays = [None if one is None else c_void_p(one.ctypes.data) for one in (law, by, size, *found, about)]
    mu, thickness = c_double(tissue.mu[layer]), c_double(tissue.thickness[layer])
    counts = c_int64(parts[1].shape[1]), c_int64(len(size))
    native.load_library().nf_law(counts[0], *arrays[:2], mu, thickness, counts[1], *arrays[2:])
    return EvaluatedLaw(*found, float(about[0]), float(about[1]), about[2:])


def test_a_table_ends_where_its_law_is_too_steep():
    """Beyond, tissue is over-compressed; a law that is too steep at once is refused."""
    tissue = Tissue(mu=[1e-4], alpha=[20.0], thickness=[1.0], law="fung", is_checked=True)
    assert compile_law("fung", np.array([[20.0]]))[0][0, 0] < 0.5
    held = Controls(base_y=0.0, guides=(Guide(10.0, 0.7, None, in_tissue=True),))
    shape = simulate(NEEDLE, tissue, Bevel(0.1), 20.0, held)
    assert not shape.converged
    with pytest.raises(ModelError, match=r"layer 2.*`fung`.* alpha = 1000"):
        compile_law("fung", np.array([[1.0, 1000.0]]))


def test_tables_of_gent_end_before_its_limit():
    assert Tissue([0.5], {"jm": 1e15}, thickness=4.0, law="gent").shape[0, 0] == 1e15
    # Tables end before I_1 - 3 = J_m; there k exceeds any Ogden one.
    for jm in (0.25, 1.0, 4.0):
        (table, _) = compile_law("gent", np.array([[jm]]))
        reach = 1 - table[0, 0]
        assert table[0, 0] + 1e-9 >= 0.2 and reach**2 + 2 / reach - 3 < jm
    assert np.isnan(LAWS["gent"].k(np.array([0.5]), np.array([0.5])))[0]


# ---- every law with all its shape parameters

STEPS = (Step(11.0, Bevel(0.1), Controls(0.5)), Step(17.3, Bevel(0.1, -1), Controls(0.5)))
LAYERS = 2


@pytest.fixture(params=[*LAWS.names(), "logarithmic"])
def law(request, tmp_path, monkeypatch):
    """Each law of the package, and the plugin's, which has two shape parameters and a table."""
    if request.param in LAWS.names():
        yield request.param
        return
    with plugin_folder(install(tmp_path), monkeypatch):
        yield request.param


def make_tissue(law, seed):
    """Thin layers, which the base compresses by a tenth: every shape parameter moves the needle."""
    shape = [np.random.default_rng(seed).uniform(*one.usual, LAYERS) for one in LAWS[law].parameters]
    return Tissue([0.4, 2.0], dict(zip(LAWS[law].shape_names, shape, strict=True)), [7.3], 5.0, 0.2, law)


@pytest.mark.parametrize("seed", [3, 4])
def test_derivatives_equal_complex_steps(law, seed):
    tissue, rules = make_tissue(law, seed), ModelOptions(tolerance=1e-10)
    _, found = linearize_steps(NEEDLE, tissue, STEPS, rules, wrt=("mu", "shape"))
    expected = [f"{name}{layer}" for name in LAWS[law].shape_names for layer in range(1, LAYERS + 1)]
    assert found.names == ("mu1", "mu2", *expected)
    assert np.abs(found.u[0]).max(axis=0).min() > 1e-6
    assert_derivatives(found, NEEDLE, tissue, STEPS, rules, rtol=1e-6)


#: the true stress over mu, lambda dW/dlambda, of the energies that the laws' files state
STRESSES = {
    "linear": lambda x: 3 * (x - 1),
    "neo_hookean": lambda x: x**2 - 1 / x,
    "ogden": lambda x, alpha: compute_stress(1.0, alpha, x, "true"),
    "two_term_ogden": lambda x, alpha, beta, share: (
        (1 - share) * compute_stress(1.0, alpha, x, "true") + share * compute_stress(1.0, beta, x, "true")
    ),
    "fung": lambda x, alpha: np.exp(alpha * (x**2 + 2 / x - 3)) * (x**2 - 1 / x),
    "gent": lambda x, jm: jm / (jm - (x**2 + 2 / x - 3)) * (x**2 - 1 / x),
}
SETS, THICKNESS_MM = 12, 10.0


def test_the_kernels_k_and_its_derivatives(law):
    """Against the derivative of the stress, where it is stated, and against differences of the law's k."""
    rng = np.random.default_rng(1)
    shapes = draw_shape(LAWS[law], rng, (SETS,))
    tissue = Tissue(np.ones(SETS), shapes, np.arange(1.0, SETS), THICKNESS_MM, law=law)
    table, exponents = compile_law(law, shapes)
    reach = 0.45 if exponents.shape[1] else min(0.45, table[:, 0].min())  # tables may end before
    d = rng.uniform(0, reach, 200)  # |e| / t
    for layer in range(SETS):
        shape = [np.full(len(d), value) for value in shapes[:, layer]]
        k, tangent, *_ = evaluated(tissue, layer, d * THICKNESS_MM)
        true = LAWS[law].k(1 - d, *shape)
        if law in STRESSES:
            true = STRESSES[law](1 - d + 1j * H, *shape).imag / H
        assert np.max(np.abs(k / true - 1)) < 1e-9
        by_d, *by_shape = (differences(LAWS[law].k, (1 - d, *shape), n) for n in range(1 + len(shape)))
        assert np.max(np.abs(tangent - k + d * by_d) / k) < 1e-6
        for number, true in enumerate(by_shape):
            found = evaluated(tissue, layer, d * THICKNESS_MM, number).by_shape
            assert np.max(np.abs(found - true) / k) < 1e-6


def differences(function, arguments, which, step=2e-4):
    """Return a derivative of a function by central differences of fourth order."""

    def at(h):
        return function(*(one + h * (n == which) for n, one in enumerate(arguments)))

    near, far = (at(h) - at(-h) for h in (step, 2 * step))
    return (8 * near - far) / (12 * step)


def test_a_law_without_shape_parameters_is_a_table(monkeypatch):
    # exp(2 (1 - lambda)) is no sum of powers; a table and the reference agree.

    class Exponential(TissueLaw):
        name, label = "exponential", "exponential foundation"

        def k(self, stretch):
            return 3 * np.exp(2 * (1 - stretch))

    names = frozenset([*LAWS.names(), "exponential"])
    monkeypatch.setitem(LAWS._builtin, "exponential", Exponential())
    monkeypatch.setattr(LAWS, "_builtin_names", names)
    tissue = Tissue([0.4, 2.0], boundaries=[7.3], thickness=5.0, law="exponential")
    fast, slow = (solve(NEEDLE, tissue, STEPS) for solve in (simulate_steps, reference_solver.simulate_steps))
    np.testing.assert_allclose(fast.u, slow.u, rtol=0, atol=1e-7)


# ---- stress of the Ogden solid in compression: against its energy, the foundation's k, and other solids

STRETCH = np.linspace(0.35, 1.1, 40)


def energy(mu, alpha, stretch):
    return 2 * mu / alpha**2 * (stretch**alpha + 2 * stretch ** (-alpha / 2) - 3)


@pytest.mark.parametrize("alpha", [-20.0, -4.7, -1.0, 0.2, 1.0, 2.0, 9.0, 25.0])
def test_the_nominal_stress_is_the_derivative_of_the_energy(alpha):
    by_energy = np.imag(energy(3.0, alpha, STRETCH + H * 1j)) / H
    assert compute_stress(3.0, alpha, STRETCH, "nominal") == approx(by_energy, rel=1e-12, abs=1e-13)


def test_at_alpha_0_the_stress_is_logarithmic():
    assert compute_stress(5.0, 0.0, STRETCH, "true") == approx(15 * np.log(STRETCH), rel=1e-14)
