"""Equilibria whose solution is known in closed form, with the observed order of convergence."""

import numpy as np
import pytest

from needlefit.mechanics.control import Controls, ModelOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import equilibrium
from needlefit.mechanics.tissue import Tissue

EI = 1.0e4


def grid(depth: float, y: float) -> np.ndarray:
    x = np.arange(0.0, depth + 0.5)
    return np.column_stack((x, np.full_like(x, y)))


def test_cantilever_under_a_uniform_load_on_its_outer_part() -> None:
    """Very soft tissue whose constraint points lie very far away pulls with a uniform load."""
    load, away, length, depth = 1e-6, 1e6, 120.0, 90.0
    tissue = Tissue(mu=[load / away / 3], alpha=[1.0], thickness=[1e9], law="linear")
    shape = equilibrium(Needle(length, EI), tissue, grid(depth, away))
    a = length - depth  # the load begins here
    tip = load * (3 * length**4 - 4 * length * a**3 + a**4) / (24 * EI)
    assert shape.tip_lateral == pytest.approx(tip, rel=1e-7)


def beam_on_foundation(k: float, free: float, depth: float, x: np.ndarray) -> np.ndarray:
    """Hetenyi: base displaced by 1 and clamped, free span, then a uniform foundation to a free tip.

    Four constants of the cubic before the tissue, four of the decaying and growing waves in it; clamped
    base, continuity of u to u''' at the entry, and no moment or shear at the tip determine all eight.
    """
    beta = (k / (4 * EI)) ** 0.25
    rates = beta * np.array([-1 + 1j, 1 + 1j])

    def waves(at: float, order: int) -> np.ndarray:
        # the growing wave is scaled at the tip, the decaying one at the entry
        values = [r**order * np.exp(r * (at - (depth if r.real > 0 else 0.0))) for r in rates]
        return np.array([part for value in values for part in (value.real, value.imag)])

    def cubic(at: float, order: int) -> np.ndarray:
        powers = np.zeros(4)
        for p in range(order, 4):
            powers[p] = np.prod(np.arange(p, p - order, -1)) * at ** (p - order)
        return powers

    none = np.zeros(4)
    rows = [np.r_[cubic(-free, 0), none], np.r_[cubic(-free, 1), none]]
    rows += [np.r_[cubic(0.0, n), -waves(0.0, n)] for n in range(4)]
    rows += [np.r_[none, waves(depth, 2)], np.r_[none, waves(depth, 3)]]
    constants = np.linalg.solve(np.array(rows), np.r_[1.0, np.zeros(7)])
    return np.array([waves(at, 0) @ constants[4:] for at in x])


def foundation_error(k: float, h: float) -> float:
    depth, length = 40.0, 60.0
    tissue = Tissue(mu=[k / 3], alpha=[1.0], law="linear")
    shape = equilibrium(
        Needle(length, EI),
        tissue,
        grid(depth, 0.0),
        Controls(base_y=1.0),
        ModelOptions(element=h, tolerance=1e-10),
    )
    inside = shape.x >= 0
    exact = beam_on_foundation(k, length - depth, depth, shape.x[inside])
    return float(np.max(np.abs(shape.u[inside] - exact)))


@pytest.mark.parametrize("k", [0.6, 99.0])
def test_one_millimetre_elements_are_ample_on_a_foundation(k: float) -> None:
    assert foundation_error(k, 1.0) < 2e-6


def test_observed_order_is_four() -> None:
    """From 1/2 mm on, where an element is no longer split by a change of constraint."""
    errors = [foundation_error(3000.0, h) for h in (0.5, 0.25, 0.125)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 4.0, atol=0.2)


def test_semi_infinite_limit_is_hetenyis_decaying_wave() -> None:
    """Deep in stiff tissue, a needle clamped and displaced at the entry follows e^-bx (cos bx + sin bx)."""
    k = 30.0
    beta = (k / (4 * EI)) ** 0.25
    shape = equilibrium(
        Needle(80.01, EI),
        Tissue(mu=[k / 3], alpha=[1.0], law="linear"),
        grid(80.0, 0.0),
        Controls(base_y=1.0),
        ModelOptions(element=0.25),
    )
    x = shape.x[1:]
    wave = np.exp(-beta * x) * (np.cos(beta * x) + np.sin(beta * x))
    np.testing.assert_allclose(shape.u[1:], wave, atol=2e-3)  # the base stands 0.01 mm before the entry


def test_linear_law_obeys_superposition() -> None:
    tissue = Tissue(mu=[0.3, 20.0], alpha=[1.0, 1.0], boundaries=[12.3], law="linear")
    needle, points = Needle(120.0, EI), grid(30.0, 0.0)
    once = equilibrium(needle, tissue, points, Controls(base_y=0.4))
    twice = equilibrium(needle, tissue, points, Controls(base_y=0.8))
    np.testing.assert_allclose(twice.u, 2 * once.u, atol=1e-9)
