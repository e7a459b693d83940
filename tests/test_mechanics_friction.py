"""Friction: a shaft that slides askew is held back less, by the factor 1 - gamma sin^2 of its angle."""

import numpy as np
import pytest

from needlefit.mechanics import reference
from needlefit.mechanics.control import Bevel, Controls
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import equilibrium, simulate
from needlefit.mechanics.tissue import Tissue

EI = 1.0e4
NEEDLE = Needle(120.0, EI)


def pulled(gamma: float, slope: float, depth: float = 90.0) -> float:
    """Return how far very soft, very distant tissue bends the tip of a tilted needle, mm; load 1e-6 N/mm."""
    load, away = 1e-6, 1e8
    tissue = Tissue(mu=[load / away / 3], alpha=[1.0], thickness=[1e9], friction=[gamma], law="linear")
    points = np.column_stack((np.arange(0.0, depth + 0.5), np.full(int(depth) + 1, away)))
    shape = equilibrium(NEEDLE, tissue, points, Controls(base_slope=slope))
    return float(shape.u[-1]) - slope * NEEDLE.length


@pytest.mark.parametrize(("gamma", "factor"), [(0.0, 1.0), (0.5, 0.9), (1.0, 0.8), (2.0, 0.6)])
def test_a_tilted_cantilever_carries_the_load_less_friction(gamma: float, factor: float) -> None:
    """At slope 1/2 sin^2 is 1/5; the closed form is that of a uniform load on the outer part."""
    length, a = NEEDLE.length, 30.0
    whole = 1e-6 * (3 * length**4 - 4 * length * a**3 + a**4) / (24 * EI)
    assert pulled(gamma, 0.5) == pytest.approx(factor * whole, rel=1e-3)
    assert pulled(gamma, -0.5) == pytest.approx(factor * whole, rel=1e-3)


@pytest.mark.parametrize("gamma", [1.0, 3.0])
def test_the_compiled_model_is_the_readable_one_where_friction_is_strong(gamma: float) -> None:
    fast, slow = (steep(solve, gamma) for solve in (simulate, reference.simulate))
    np.testing.assert_allclose(fast.u, slow.u, atol=1e-8)


@pytest.mark.parametrize("solve", [simulate, reference.simulate])
def test_newton_stays_quadratic_with_friction(solve) -> None:
    """Its slope is part of Newton's matrix: it costs at most one iteration in each of the twelve cells."""
    assert steep(solve, 3.0).iterations <= steep(solve, 0.0).iterations + 12


def steep(solve, gamma: float) -> NeedleShape:
    """Insert a needle whose base is tilted by a fifth."""
    tissue = Tissue(mu=[0.5], alpha=[2.0], friction=[gamma])
    shape = solve(NEEDLE, tissue, Bevel(0.1), 12.0, Controls(base_slope=0.2))
    assert shape.converged
    return shape
