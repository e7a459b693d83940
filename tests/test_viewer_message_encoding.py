"""The page's messages of forces and loads: their signs and sizes, from closed forms."""

import numpy as np
import pytest
from page_state import encode_state

from needlefit.mechanics.scene import Scene
from needlefit.schemas.scene import SceneRecord
from needlefit.viewer.messages import encode_scene
from needlefit.viewer.steering import Change, SteeredNeedle
from needlefit.viewer.viewed_scene import ViewedScene

LENGTH, K = 150.0, 0.3  # mm; N/mm per mm
STIFF, NEEDLE = 1e10, 1e4  # N mm^2


@pytest.fixture
def encode():
    """Return the message to the page after steps, of a needle in even, linear tissue."""

    def state(rigidity: float, *steps: dict) -> dict:
        record = SceneRecord.model_validate(
            {
                "schema": 1,
                "depth_mm": 40.0,
                "law": "linear",
                "needle": {"length_mm": LENGTH, "flexural_rigidity_nmm2": rigidity},
                "layers": [{"top_mm": 0.0, "mu_pa": K / 3 * 1e6, "alpha": 1.0}],
                "bevel": {"offset_mm": 0.0},
            }
        )
        steering = SteeredNeedle(Scene.from_record(record), 1.0)  # beyond the limits, too
        for step in steps:
            changes = [(name.split("@"), value) for name, value in step.items()]
            steering.apply(
                [Change(name, int(*item) if item else None, value) for (name, *item), value in changes]
            )
        return encode_state(ViewedScene("even", "even", "", record, 1.0), steering)

    return state


def test_a_base_moved_up_is_borne_by_a_guide_that_clamps(encode) -> None:
    """Both ends clamped, a apart, one moved aside by y: 12 EI y / a^3, and 6 EI y / a^2 at the base."""
    a, y = 120.0, 0.4
    guide = {"guide_x_mm@1": a - LENGTH, "guide_y_mm@1": 0.0}
    forces = encode(NEEDLE, guide, {"base_y_mm": y})["forces"]
    assert forces["base_n"] == pytest.approx(12 * NEEDLE * y / a**3)
    assert forces["base_nmm"] == pytest.approx(6 * NEEDLE * y / a**2)
    assert forces["guides_n"] == {"1": pytest.approx(-forces["base_n"])}
    assert forces["tip_n"] == 0.0


def test_forces_are_assigned_to_the_guide_that_bears_them(encode) -> None:
    """Number 2 stands nearer to the base; the free part beyond number 1 bears nothing."""
    first = {"guide_x_mm@1": -20.0, "guide_y_mm@1": 0.0, "guide_turns_freely@1": 1.0}
    second = {"guide_x_mm@2": -50.0, "guide_y_mm@2": 0.0}
    forces = encode(NEEDLE, first | second, {"base_y_mm": 0.4})["forces"]
    assert forces["guides_n"]["2"] == pytest.approx(-12 * NEEDLE * 0.4 / 100.0**3)
    assert forces["guides_n"]["1"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("y", [0.2, -0.2])
def test_tissue_pushes_a_needle_moved_aside_back_to_its_cut(encode, y) -> None:
    """One that does not bend, 40 mm deep: -k y on every millimetre, which the base holds against.

    Of that the tip bears the last point's half cell; the base's moment is about itself, at D - L.
    """
    state = encode(STIFF, {"depth_mm": 40.0}, {"base_y_mm": y})
    forces, load = state["forces"], state["load"]
    np.testing.assert_allclose(load["n_per_mm"], -K * y, rtol=2e-3)
    np.testing.assert_allclose(load["y"], y, rtol=2e-3)
    assert forces["base_n"] == pytest.approx(K * y * 40, rel=2e-3)
    assert forces["base_nmm"] == pytest.approx(K * y * 40 * (LENGTH - 20), rel=2e-3)
    assert forces["tip_n"] == pytest.approx(-K * y * 0.5, rel=2e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_cut_that_a_bevel_makes_pulls_the_tip_to_its_side(encode, side) -> None:
    state = encode(NEEDLE, {"bevel_side": side, "bevel_offset_mm": 0.2}, {"depth_mm": 30.0})
    assert side * state["forces"]["tip_n"] > 0
    assert side * state["load"]["n_per_mm"][-1] > 0
    assert side * state["tip"]["lateral_mm"] > 0


def test_constraint_points_are_sent_with_the_needle(encode) -> None:
    """A steep one, shortened along x: its last point and its path end at its tip."""
    state = encode(NEEDLE, {"bevel_offset_mm": 0.4}, {"depth_mm": 100.0})
    tip = state["tip"]["x"]
    assert 100.0 - tip > 1.0
    assert state["constraints"][0][-1] == state["tip_path"][0][-1] == tip == state["x"][-1]
    assert state["tip_path"][1][-1] == pytest.approx(state["tip"]["y"], abs=1e-4)


@pytest.mark.parametrize(("y", "faults"), [(2.0, 0), (6.0, 2)])
def test_the_page_is_given_the_limits_that_are_exceeded(encode, y, faults) -> None:
    """The needle's slope is greatest between base and guide, where no node stands."""
    found = encode(NEEDLE, {"guide_x_mm@1": 20.0 - LENGTH, "guide_y_mm@1": 0.0}, {"base_y_mm": y})
    assert found["max_slope"] == pytest.approx(1.5 * y / 20.0) and len(found["faults"]) == faults


def test_the_page_gets_every_shape_parameter_with_symbol_and_limits() -> None:
    layers = [
        {"top_mm": 0.0, "mu_pa": 2e5, "shape": {"jm": 5.0}},
        {"top_mm": 9.0, "mu_pa": 3e5, "shape": {"jm": 0.3}},
    ]
    record = SceneRecord.model_validate(
        {
            "schema": 1, "depth_mm": 20.0, "law": "gent", "layers": layers, "bevel": {"offset_mm": 0.05},
            "needle": {"length_mm": LENGTH, "flexural_rigidity_nmm2": NEEDLE},
        }
    )  # fmt: skip
    viewed_scene = ViewedScene("gent", "gent", "", record, 1.0)
    message = encode_scene(viewed_scene, SteeredNeedle(Scene.from_record(record), 1.0))
    (jm,) = message["shape_parameters"]
    assert {name: jm[name] for name in ("name", "symbol", "unit")} == {
        "name": "jm",
        "symbol": "Jm",
        "unit": "",
    }
    assert jm["explanation"]
    assert message["fitted"]["layers"] == [
        {"mu_pa": pytest.approx(2e5), "jm": 5.0},
        {"mu_pa": pytest.approx(3e5), "jm": 0.3},
    ]
    low, high = message["limits"]["jm"]
    assert low == 0.2 and high >= 10.0
