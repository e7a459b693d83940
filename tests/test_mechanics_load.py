"""What acts on the needle: closed forms, and the balance of all forces and moments."""

import numpy as np
import pytest

from needlefit.mechanics import reference
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import compute_lateral_load, compute_loads, simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue

EI = 1.0e4
NEEDLE = Needle(150.0, EI)
LAYERS = Tissue(
    mu=[0.02, 0.4, 0.1], alpha=[3.0, -4.0, 8.0], boundaries=[9.3, 21.0], thickness=[40.0, 8.0, 15.0]
)


# ---- closed forms ----


def test_a_guide_before_the_tissue_loads_the_needle_as_a_propped_or_clamped_cantilever():
    # A cantilever of length a is moved by y under F = 3 EI y / a^3; its clamp bears -F and -F a.
    controls, a, y = Controls(guides=(Guide(-30.0, 0.4, None),)), 120.0, 0.4
    shape = simulate_steps(NEEDLE, LAYERS, (Step(0.0, Bevel(0.1), controls),))
    found = compute_loads(shape, LAYERS, NEEDLE, controls)
    force = 3 * EI * y / a**3
    assert found.guides[0].force == pytest.approx(force)
    assert (found.base.x, found.base.force) == (-150.0, pytest.approx(-force))
    assert (found.base.moment, found.guides[0].moment) == (pytest.approx(-force * a), 0.0)
    assert len(found.s) == 0 and (found.tip_force, found.tissue.force) == (0.0, 0.0)
    # Both ends clamped, one moved aside by y: 12 EI y / a^3 and 6 EI y / a^2.
    controls, a, y = Controls(guides=(Guide(-30.0, 0.4),)), 120.0, 0.4
    shape = simulate_steps(NEEDLE, LAYERS, (Step(0.0, Bevel(0.1), controls),))
    found = compute_loads(shape, LAYERS, NEEDLE, controls)
    assert found.guides[0].force == pytest.approx(12 * EI * y / a**3)
    assert found.guides[0].moment == pytest.approx(found.base.moment) == pytest.approx(-6 * EI * y / a**2)


def test_where_there_is_a_load_and_its_sign():
    # The bevel lays the cut aside, toward its side; there the tissue pulls the tip.
    for side in (1, -1):
        shape = simulate(NEEDLE, LAYERS, Bevel(0.2, side), 30.0)
        assert side * compute_loads(shape, LAYERS, NEEDLE, Controls()).tip_force > 0
    controls = Controls(guides=(Guide(-20.0), Guide(25.0, 0.3, 0.0, in_tissue=True)))
    shape = simulate(NEEDLE, LAYERS, Bevel(0.2), 20.0, controls)
    found = compute_loads(shape, LAYERS, NEEDLE, controls)
    assert [held.x for held in found.guides] == [-20.0, 25.0]
    assert (found.guides[1].force, found.guides[1].moment) == (0.0, 0.0)
    assert compute_lateral_load(shape, LAYERS, np.array([-100.0, -20.0, -1e-6])).tolist() == [0.0, 0.0, 0.0]
    tissue = Tissue(mu=[1.0], alpha=[3.0], thickness=[0.5])
    controls = Controls(base_y=30.0, guides=(Guide(-0.5, 30.0),))
    shape = simulate(NEEDLE, tissue, Bevel(0.1), 20.0, controls)
    assert not shape.converged
    found = compute_loads(shape, tissue, NEEDLE, controls)
    assert np.isnan([found.base.force, found.guides[0].force, found.tip_force]).all()


@pytest.mark.parametrize("switch", [0.0, 0.5, 0.7])
def test_the_load_is_that_of_the_reference(switch: float) -> None:
    tissue = Tissue(LAYERS.mu, LAYERS.alpha, LAYERS.boundaries, LAYERS.thickness, np.array([0.5, 2.0, 1.0]))
    rules, controls = ModelOptions(switch=switch), Controls(base_slope=0.1)
    shape = simulate(NEEDLE, tissue, Bevel(0.2), 27.4, controls, rules)
    change = reference.change_depths(shape.constraints[:, 0], rules)
    x, weight = reference.quadrature(shape.x, change, tissue.boundaries)
    value, slope = (
        rows @ np.column_stack((shape.u, shape.slope)).ravel()
        for rows in reference.shape_functions(shape.x, x)
    )
    layer = np.searchsorted(tissue.boundaries, x)
    e = value - shape.constraints[np.searchsorted(change, x), 1]
    k, _ = reference.modulus(tissue, layer, 1 - np.abs(e) / tissue.thickness[layer])
    expected = -k * e * (1 - tissue.friction[layer] * np.sin(np.arctan(slope)) ** 2)
    found = compute_loads(shape, tissue, NEEDLE, controls, rules)
    np.testing.assert_allclose(found.s, x, atol=1e-12)
    np.testing.assert_allclose(found.weight, weight, atol=1e-12)
    np.testing.assert_allclose(found.load, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(compute_lateral_load(shape, tissue, x, rules), expected, rtol=1e-9, atol=1e-12)
