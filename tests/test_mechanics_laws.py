"""Tissue laws: what each says by hand, and how truly the kernel's polynomial says it."""

from pathlib import Path

import numpy as np
import pytest
from mechanics_cases import NEEDLE, assert_derivatives, draw_shape
from numpy.random import default_rng
from plugin_cases import install, plugin_folder
from pytest import approx

from needlefit import Bevel, Controls, Guide, ModelOptions, Step, Tissue, compute_stress, simulate
from needlefit.errors import ModelError
from needlefit.mechanics.batch import linearize_steps
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.packing import compile_law

H = 1e-30  # of complex steps


def test_a_table_ends_where_its_law_is_too_steep():
    """Beyond, tissue is over-compressed; a law that is too steep at once is refused."""
    tissue = Tissue(mu=[1e-4], alpha=[20.0], thickness=[1.0], law="fung", is_checked=True)
    assert compile_law("fung", np.array([[20.0]]))[0][0, 0] < 0.5
    held = Controls(base_y=0.0, guides=(Guide(10.0, 0.7, None, in_tissue=True),))
    shape = simulate(NEEDLE, tissue, Bevel(0.1), 20.0, held)
    assert not shape.converged
    with pytest.raises(ModelError, match=r"layer 2.*`fung`.* alpha = 1000"):
        compile_law("fung", np.array([[1.0, 1000.0]]))


def test_the_model_page_lists_every_law():
    page = (Path(__file__).parents[1] / "docs" / "model.md").read_text(encoding="utf-8")
    assert {*LAWS.names()} <= {line.split("`")[1] for line in page.splitlines() if line.startswith("| `")}


def test_tables_of_gent_end_before_its_limit():
    assert Tissue([0.5], {"jm": 1e15}, thickness=4.0, law="gent").shape[0, 0] == 1e15
    # Tables end before I_1 - 3 = J_m; there k exceeds any Ogden one.
    for jm in (0.25, 1.0, 4.0):
        (table, _) = compile_law("gent", np.array([[jm]]))
        reach = 1 - table[0, 0]
        assert table[0, 0] + 1e-9 >= 0.2 and reach**2 + 2 / reach - 3 < jm
    assert np.isnan(LAWS["gent"].k(np.array([0.5]), np.array([0.5])))[0]


# ---- every law with all its shape parameters

STEPS = (Step(8.0, Bevel(0.1), Controls(0.5)), Step(11.3, Bevel(0.1, -1), Controls(0.5)))
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
    shape = [default_rng(seed).uniform(*one.usual, LAYERS) for one in LAWS[law].parameters]
    return Tissue([0.4, 2.0], dict(zip(LAWS[law].shape_names, shape, strict=True)), [7.3], 5.0, 0.2, law)


def test_derivatives_equal_complex_steps(law):
    tissue, rules = make_tissue(law, 3), ModelOptions(tolerance=1e-10)
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


@pytest.mark.parametrize("law", STRESSES)
def test_k_is_the_derivative_of_the_stress(law):
    """The kernel's k is compared with that of the law where the reference solver is compared with it."""
    shapes = draw_shape(LAWS[law], default_rng(1), (12, 1))
    stretch = 1 - np.linspace(0.0, 0.15, 50)  # above the limit of every Gent law that is drawn
    stress = STRESSES[law](stretch + 1j * H, *shapes)
    np.testing.assert_allclose(LAWS[law].k(stretch, *shapes), stress.imag / H, rtol=1e-9)


# ---- stress of the Ogden solid in compression: against its energy, the foundation's k, and other solids

STRETCH = np.linspace(0.35, 1.1, 40)


@pytest.mark.parametrize("alpha", [-20.0, -4.7, -1.0, 0.2, 1.0, 2.0, 9.0, 25.0])
def test_the_nominal_stress_is_the_derivative_of_the_energy(alpha):
    at = STRETCH + H * 1j
    by_energy = np.imag(2 * 3.0 / alpha**2 * (at**alpha + 2 * at ** (-alpha / 2) - 3)) / H
    assert compute_stress(3.0, alpha, STRETCH, "nominal") == approx(by_energy, rel=1e-12, abs=1e-13)


def test_at_alpha_0_the_stress_is_logarithmic():
    assert compute_stress(5.0, 0.0, STRETCH, "true") == approx(15 * np.log(STRETCH), rel=1e-14)
