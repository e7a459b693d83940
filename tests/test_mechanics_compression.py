"""Stress of the Ogden solid in compression: against its energy, the foundation's k, and other solids."""

import numpy as np
import pytest

from needlefit.mechanics.compression import compute_log_stress_derivative, compute_stress
from needlefit.mechanics.laws import LAWS

STRETCH = np.linspace(0.35, 1.1, 40)
ALPHAS = (-20.0, -4.7, -1.0, -1e-3, 0.0, 1e-6, 0.2, 1.0, 2.0, 9.0, 25.0)
H = 1e-30


def energy(mu, alpha, stretch):
    return 2 * mu / alpha**2 * (stretch**alpha + 2 * stretch ** (-alpha / 2) - 3)


@pytest.mark.parametrize("alpha", [a for a in ALPHAS if abs(a) > 1e-2])
def test_the_nominal_stress_is_the_derivative_of_the_energy(alpha):
    by_energy = np.imag(energy(3.0, alpha, STRETCH + H * 1j)) / H
    assert compute_stress(3.0, alpha, STRETCH, "nominal") == pytest.approx(by_energy, rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("alpha", ALPHAS)
def test_the_foundations_k_is_the_derivative_of_the_true_stress(alpha):
    """The paper's Eq. 4: of the true stress, not of the nominal one."""
    k = 3.0 * LAWS["ogden"].k(STRETCH, np.full_like(STRETCH, alpha))
    slope = np.imag(compute_stress(3.0, alpha, STRETCH + H * 1j, "true")) / H
    assert slope == pytest.approx(k, rel=1e-11)
    for measure in ("nominal", "true"):  # in small strain Young's modulus is 3 mu, compression negative
        small = compute_stress(2.0, alpha, np.array([1 - 1e-7, 1.0]), measure)
        assert small == pytest.approx([-6e-7, 0.0], rel=1e-5)
    moved = compute_stress(1.0, alpha + H * 1j, STRETCH, "nominal")
    growth = np.imag(moved) / H / np.real(moved)
    assert compute_log_stress_derivative(alpha, STRETCH) == pytest.approx(growth, rel=1e-9, abs=1e-12)


def test_true_and_nominal_stress_and_solids_that_alpha_stands_for():
    true, nominal = (compute_stress(1.0, -3.0, STRETCH, kind) for kind in ("true", "nominal"))
    assert true == pytest.approx(STRETCH * nominal, rel=1e-14)
    neo_hookean = 5.0 * (STRETCH - STRETCH**-2)
    assert compute_stress(5.0, 2.0, STRETCH, "nominal") == pytest.approx(neo_hookean, rel=1e-12, abs=1e-14)
    assert compute_stress(5.0, 0.0, STRETCH, "true") == pytest.approx(15 * np.log(STRETCH), rel=1e-14)
    deep = np.linspace(0.5, 0.7, 9)
    ratio = compute_stress(1.0, -20.0, deep, "nominal") / compute_stress(1.0, 40.0, deep, "nominal")
    assert ratio == pytest.approx(np.full(9, 2.0), rel=1e-4)  # 2 mu / alpha of the power that both share
