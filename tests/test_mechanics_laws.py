"""Tissue laws: what each says by hand, and how truly the kernel's polynomial says it."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from needlefit.errors import ModelError
from needlefit.mechanics import laws, reference
from needlefit.mechanics.control import Bevel, Controls
from needlefit.mechanics.kernel.foundation import make_foundation
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import compile_tissue, simulate
from needlefit.mechanics.tissue import Tissue

NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)
BASE = Controls(base_y=0.4)


def modulus(law: str, alpha: float, stretch: np.ndarray) -> np.ndarray:
    """Return k / mu, written as in the paper."""
    if law == "linear":
        return np.full_like(stretch, 3.0)
    alpha = 2.0 if law == "neo_hookean" else alpha
    return 2 * (stretch ** (alpha - 1) + 0.5 * stretch ** (-alpha / 2 - 1))


@pytest.mark.parametrize("law", laws.list_laws())
@pytest.mark.parametrize("thickness", [0.3, 5.0, 40.0, 80.0])
def test_the_polynomial_is_the_law_as_far_as_it_is_used(law: str, thickness: float) -> None:
    """To 1e-9 of k, and its tangent d(k e)/de to 1e-7, over the widest prior."""
    for alpha in np.linspace(-10, 10, 41):
        layer = compile_tissue(Tissue(mu=[0.7], alpha=[alpha], thickness=[thickness], law=law))
        e = np.linspace(0.0, layer.limit[0], 50)
        assert 0.004 * thickness < layer.limit[0] <= 0.2 * thickness
        found = np.polynomial.Polynomial(layer.series[0])
        exact = 0.7 * modulus(law, alpha, 1 - e / thickness)
        np.testing.assert_allclose(found(e), exact, rtol=1e-9)
        tangent = (found * np.polynomial.Polynomial([0.0, 1.0])).deriv()
        step = 1e-6 * thickness
        ends = [(e + s) * 0.7 * modulus(law, alpha, 1 - (e + s) / thickness) for s in (step, -step)]
        np.testing.assert_allclose(tangent(e), (ends[0] - ends[1]) / (2 * step), rtol=1e-7)


@pytest.mark.parametrize("alpha", [-3.0, 1.0, 2.0, 5.0])
def test_how_tissue_hardens_at_first(alpha: float) -> None:
    """Ogden: dk/de = 3 mu (1 - alpha / 2) / t at rest; it hardens below alpha = 2 and softens above."""
    layer = compile_tissue(Tissue(mu=[0.7], alpha=[alpha], thickness=[40.0]))
    assert layer.series[0, 0] == pytest.approx(3 * 0.7, rel=1e-9)
    assert layer.series[0, 1] == pytest.approx(3 * 0.7 * (1 - alpha / 2) / 40.0, abs=1e-8)


def test_the_linear_law_is_a_number() -> None:
    layer = compile_tissue(Tissue(mu=[0.7], alpha=[5.0], law="linear"))
    np.testing.assert_allclose(layer.series[0], [2.1, 0, 0, 0, 0, 0], atol=1e-12)
    assert layer.curvature[0] < 1e-9


def test_layers_are_independent() -> None:
    def layers(mu: list, alpha: list, thickness: list):
        terms = laws.power_terms("ogden", np.array(alpha))
        return make_foundation(np.array(mu), *terms, np.array(thickness), np.zeros(len(mu)))

    both, second = layers([0.2, 3.0], [-7.0, 4.0], [5.0, 60.0]), layers([3.0], [4.0], [60.0])
    np.testing.assert_array_equal(both.series[1], second.series[0])
    assert both.limit[1] == second.limit[0] and both.curvature[1] == second.curvature[0]


def deflection(law: str, alpha: float, thickness: float = 4.0) -> float:
    tissue = Tissue(mu=[0.5], alpha=[alpha], thickness=[thickness], law=law)
    shape = simulate(NEEDLE, tissue, Bevel(0.1), 20.0, BASE)
    assert shape.converged
    return shape.deflection


def test_neo_hookean_is_ogden_at_two() -> None:
    assert deflection("neo_hookean", -5.0) == deflection("ogden", 2.0)
    assert abs(deflection("ogden", 2.0) - deflection("ogden", 1.0)) > 1e-5


def test_linear_and_neo_hookean_do_not_use_alpha() -> None:
    for law in ("linear", "neo_hookean"):
        assert deflection(law, -9.0) == deflection(law, 9.0)


def test_the_linear_law_does_not_use_the_thickness() -> None:
    assert deflection("linear", 1.0, 4.0) == pytest.approx(deflection("linear", 1.0, 40.0), abs=1e-9)


def test_in_thick_tissue_every_law_is_linear() -> None:
    linear = deflection("linear", 1.0)
    off = [abs(deflection("ogden", -6.0, thickness) - linear) for thickness in (1e1, 1e3, 1e5)]
    assert off[0] > 1e-3
    assert off[0] > 50 * off[1] > 2500 * off[2]


@pytest.fixture
def sister(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Put one more file into the folder of laws."""
    (tmp_path / "sister.py").write_text("def terms(alpha):\n    return [(3.0, -alpha), (0.5, 2.0)]\n")
    monkeypatch.setattr(laws, "__path__", [*laws.__path__, str(tmp_path)])
    caches = (laws.list_laws, laws.term_slopes, laws._make_terms_at_zero)
    for cached in caches:
        cached.cache_clear()
    yield "sister"
    for cached in caches:
        cached.cache_clear()
    sys.modules.pop("needlefit.mechanics.laws.sister", None)


def test_a_law_is_one_file(sister: str) -> None:
    """It is found by its name, and neither reference nor kernel needs a change."""
    assert sister in laws.list_laws()
    tissue = Tissue(mu=[0.5], alpha=[4.0], thickness=[2.0], law=sister)
    case = (NEEDLE, tissue, Bevel(0.1), 9.0, BASE)
    fast, slow = simulate(*case), reference.simulate(*case)
    np.testing.assert_allclose(fast.u, slow.u, atol=1e-8)
    assert compile_tissue(tissue).series[0, 0] == pytest.approx(0.5 * 3.5, rel=1e-9)


def test_without_that_file_there_is_no_such_law() -> None:
    with pytest.raises(ModelError, match=r"law .*`sister`"):
        compile_tissue(Tissue(mu=[0.5], alpha=[4.0], law="sister"))
