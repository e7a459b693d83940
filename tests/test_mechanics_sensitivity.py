"""The Jacobian is the derivative: complex steps through the equations, and what is known beforehand."""

from dataclasses import fields, replace

import numpy as np
import pytest
from mechanics_cases import NEEDLE, RULES, assert_derivatives, random_case

from needlefit.errors import ModelError
from needlefit.mechanics.batch import DERIVATIVE_KINDS, differentiate_positions, linearize, linearize_steps
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step, TrackedTip
from needlefit.mechanics.law_form import compile_law, differentiate_law
from needlefit.mechanics.laws import LAWS, PowerLaw
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice, make_lattice
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue

PHANTOM = Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=[20, 28, 45])
SHARP = 1e-9  # mm; Newton's tolerance where a derivative is held to 1e-7 of itself


def check(needle: Needle, tissue: Tissue, steps: list[Step], rules: ModelOptions, lattice=None) -> None:
    shape, found = linearize_steps(needle, tissue, steps, rules, lattice, wrt=DERIVATIVE_KINDS)
    assert shape.converged
    # where the cut is linear, complex places of its corners are known less well
    assert_derivatives(found, needle, tissue, steps, rules, lattice, 1e-6 if rules.path_angle else 1e-7)


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("seed", range(12))
def test_jacobian_equals_complex_steps(seed: int, kind: str) -> None:
    """Guides before and in the tissue, a tracked tip, retraction, re-insertion, changes of base and bevel."""
    rng = np.random.default_rng(seed)
    needle, tissue, steps, rules, lattice = random_case(rng, kind, 3, 14.0)
    # in soft tissue rounding alone moves the derivative by more than 1e-7 of itself on a fine mesh
    rules = replace(rules, tolerance=SHARP, element=max(rules.element, 0.5))
    tissue = replace(tissue, mu=np.maximum(tissue.mu, 0.03 if kind != "path_angle" else 0.1))
    lattice = lattice or make_lattice(steps, rules)
    changes = np.array([lattice.depth(m) for m in range(60)])
    changes = (1 - rules.switch) * changes[:-1] + rules.switch * changes[1:]
    if tissue.layers > 1 and np.min(np.abs(tissue.boundaries[:, None] - changes)) < 1e-3:
        pytest.skip("a boundary near a change of constraint has two derivatives")
    check(needle, tissue, steps, rules, lattice)


def test_jacobian_beyond_the_series_of_the_law() -> None:
    """A base moved sideways compresses thin tissue by a third; the law is evaluated, not its series."""
    tissue = Tissue(mu=[0.05, 0.1], alpha=[8.0, -3.0], boundaries=[5.3], thickness=[3.0], friction=[0.2])
    shape = simulate(NEEDLE, tissue, Bevel(0.02), 12.0, Controls(base_y=1.0))
    assert np.max(np.abs(shape.u[1:])) / 3.0 > 0.1
    check(NEEDLE, tissue, [Step(12.0, Bevel(0.02), Controls(base_y=1.0))], ModelOptions(tolerance=SHARP))


def test_the_tips_derivatives_on_the_way_are_those_of_an_insertion_that_stops_there() -> None:
    """A guide moves on the way; within each step and at the end the tip's derivatives are known otherwise."""
    moves = zip((10.0, 20.0, 30.0), (0.0, 1.5, -1.0), strict=True)
    steps = [Step(depth, Bevel(0.05), Controls(guides=(Guide(-20.0, y),))) for depth, y in moves]
    lattice, kinds = Lattice(1.0, 1.0), ("mu", "shape", "offset", "guides")
    shape, whole = linearize_steps(NEEDLE, PHANTOM, steps, lattice=lattice, wrt=kinds)
    assert whole.tip_track.shape == (len(shape.tip_track), len(whole.names))
    for n, depth in ((0, 7.0), (1, 11.0), (1, 19.0), (2, 25.0), (2, 30.0)):
        some = [*steps[:n], replace(steps[n], depth=depth)]
        _, stopped = linearize_steps(NEEDLE, PHANTOM, some, lattice=lattice, wrt=kinds)
        np.testing.assert_allclose(whole.tip_track[int(depth)], stopped.u[-1], rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("depth", [19.63, 55.0])
def test_the_shape_is_that_of_the_forward_run(depth: float) -> None:
    shape, _ = linearize(NEEDLE, PHANTOM, Bevel(0.085), depth)
    plain = simulate(NEEDLE, PHANTOM, Bevel(0.085), depth, rules=ModelOptions(tolerance=1e-9))
    for name in ("u", "slope", "constraints"):
        np.testing.assert_allclose(getattr(shape, name), getattr(plain, name), rtol=0, atol=1e-9)
    assert shape.iterations == plain.iterations


@pytest.mark.parametrize("side", [1, -1])
def test_the_first_constraint_point_moves_by_geometry(side: int) -> None:
    """The free needle is a rod: c_1 moves by 1 per base y, L + x_1 per base slope, s x_1 / C_int per b."""
    rules = ModelOptions(2.0, 1.0)
    _, found = linearize(
        NEEDLE, Tissue(mu=[0.2], alpha=[1.0]), Bevel(0.1, side), 7.3, rules=rules,
        wrt=("offset", "base_y", "base_slope", "stage_slope"),
    )  # fmt: skip
    first = dict(zip(found.names, found.constraints[1], strict=True))
    assert first["offset"] == pytest.approx(side * 1.3 / 2.0, rel=1e-12)
    assert first["base_y"] == pytest.approx(1.0, rel=1e-9)
    assert first["base_slope"] == pytest.approx(150.0 + 1.3, rel=1e-9)
    assert first["stage_slope"] == 0.0  # at contact the stage has not carried the base anywhere
    assert np.all(found.constraints[0] == 0.0)


def test_a_stiffer_needle_in_stiffer_tissue_and_a_tracked_tip():
    # EI d/dEI + sum mu_i d/dmu_i = 0: only their ratio matters.
    controls = Controls(base_y=0.3, guides=(Guide(-12.0),))
    shape, found = linearize(NEEDLE, PHANTOM, Bevel(0.085), 50.0, controls, wrt=("mu", "rigidity"))
    scales = np.array([*PHANTOM.mu, NEEDLE.flexural_rigidity])
    parts = found.u * scales
    assert shape.converged and np.abs(parts).max() > 0.1
    np.testing.assert_allclose(parts.sum(axis=1), 0.0, atol=1e-9)
    controls = Controls(base_y=0.2, tip=TrackedTip(0.4, 0.01))
    _, found = linearize(NEEDLE, PHANTOM, Bevel(0.085), 30.0, controls, wrt=DERIVATIVE_KINDS)
    assert not np.any(found.u[-1]) and not np.any(found.slope[-1])
    assert np.abs(found.u).max() > 0.1


def test_boundaries_between_equal_layers_or_not_reached_move_nothing():
    # But for the quadrature, whose intervals it splits.
    tissue = Tissue(mu=[2.0, 2.0, 9.0], alpha=[3.0] * 3, boundaries=[6.3, 12.8])
    _, found = linearize(NEEDLE, tissue, Bevel(0.1), 20.0, wrt=("boundaries",))
    assert np.abs(found.u[:, 1]).max() > 1e-3
    assert np.abs(found.u[:, 0]).max() < 1e-5 * np.abs(found.u[:, 1]).max()
    tissue = Tissue(mu=[2.0, 20.0, 9.0], alpha=[3.0] * 3, boundaries=[6.3, 20.0])
    _, found = linearize(NEEDLE, tissue, Bevel(0.1), 20.0, wrt=("boundaries", "mu"))
    columns = dict(zip(found.names, found.u.T, strict=True))
    assert np.abs(columns["boundary1"]).max() > 0
    assert not np.any(columns["boundary2"]) and not np.any(columns["mu3"])


@pytest.mark.parametrize("boundary", [6.5, 7.0])
def test_on_a_change_of_constraint_or_a_node_the_derivative_is_that_of_going_deeper(boundary: float) -> None:
    rules, step = ModelOptions(tolerance=1e-11), 1e-5

    def deflection(at: float) -> np.ndarray:
        tissue = Tissue(mu=[0.3, 20.0], alpha=[1.0, 1.0], boundaries=[at])
        return simulate(NEEDLE, tissue, Bevel(0.1), 12.0, rules=rules).u

    tissue = Tissue(mu=[0.3, 20.0], alpha=[1.0, 1.0], boundaries=[boundary])
    _, found = linearize(NEEDLE, tissue, Bevel(0.1), 12.0, rules=rules, wrt=("boundaries",))
    ahead = (4 * deflection(boundary + step) - 3 * deflection(boundary) - deflection(boundary + 2 * step)) / (
        2 * step
    )
    np.testing.assert_allclose(found.u[:, 0], ahead, rtol=0, atol=1e-4 * np.abs(ahead).max())


@pytest.mark.parametrize("law", ["linear", "neo_hookean"])
def test_a_law_without_alpha_has_none_in_its_derivatives(law: str) -> None:
    tissue = Tissue(mu=[0.3, 20.0], alpha=[5.0, -5.0], boundaries=[7.2], law=law)
    _, found = linearize(NEEDLE, tissue, Bevel(0.1), 12.0, wrt=("shape", "mu"))
    assert found.names == ("mu1", "mu2")
    assert np.any(found.u[:, 0])


@pytest.mark.parametrize("law", [law.name for law in LAWS.values() if isinstance(law, PowerLaw)])
def test_sums_of_powers_are_linear_term_by_term(law: str) -> None:
    shape = LAWS[law].draw_shape(np.random.default_rng(1), (3,))
    shape[:, 0] = 0.0
    terms, slopes = np.concatenate(compile_law(law, shape), axis=1), differentiate_law(law, shape)
    for layer in (1, 2):
        np.testing.assert_allclose(terms[layer], terms[0] + shape[:, layer] @ slopes, rtol=0, atol=1e-14)


def test_what_a_guide_holds_moves_with_it() -> None:
    guides = (Guide(-20.0, slope=None), Guide(-5.0, 0.1), Guide(6.0, 0.2, in_tissue=True))
    shape, found = linearize(NEEDLE, PHANTOM, Bevel(0.085), 30.0, Controls(guides=guides), wrt=("guides",))
    assert found.names == tuple(f"guide{i}_{what}" for i in (1, 2, 3) for what in ("x", "y", "slope"))
    for i, guide in enumerate(guides):
        node = int(np.flatnonzero(shape.x == guide.x)[0])
        for j in range(3):
            assert found.x[node, 3 * j] == (i == j)
            assert found.u[node, 3 * j + 1] == pytest.approx(float(i == j), abs=1e-12)
            if guide.slope is not None:
                assert found.slope[node, 3 * j + 2] == pytest.approx(float(i == j), abs=1e-12)
    assert not np.any(found.u[:, 2])  # the first leaves the needle free to turn


def test_an_inactive_guide_moves_no_node() -> None:
    """It stood at a depth where the mesh has a node of its own; then at the tip, which no guide holds."""
    guided = Controls(guides=(Guide(3.0, 0.1, in_tissue=True),))
    free_again = [Step(6.0, Bevel(0.1), guided), Step(8.0, Bevel(0.1))]
    back_to_it = [Step(6.0, Bevel(0.1), guided), Step(3.0, Bevel(0.1), guided)]
    for steps in (free_again, back_to_it):
        shape, found = linearize_steps(NEEDLE, PHANTOM, steps, wrt=("guides",))
        assert 3.0 in shape.x
        assert not np.any(found.x)


def test_guides_of_several_steps_at_one_place_are_one_guide() -> None:
    steps = [
        Step(8.0, Bevel(0.1), Controls(guides=(Guide(-9.0, 0.1),))),
        Step(12.0, Bevel(0.1), Controls(guides=(Guide(-9.0, 0.2), Guide(-4.0)))),
    ]
    _, found = linearize_steps(NEEDLE, PHANTOM, steps, wrt=("guides",))
    assert len(found.names) == 6

    def deflection(shift: float) -> np.ndarray:
        shifted = [
            Step(s.depth, s.bevel, Controls(guides=(Guide(-9.0, s.controls.guides[0].y + shift),
                                                    *s.controls.guides[1:])))
            for s in steps
        ]  # fmt: skip
        return simulate_steps(NEEDLE, PHANTOM, shifted, ModelOptions(tolerance=1e-11)).u

    slope = (deflection(1e-4) - deflection(-1e-4)) / 2e-4
    np.testing.assert_allclose(found.u[:, 1], slope, atol=1e-6)


@pytest.mark.parametrize("lower", [False, True])
def test_a_boundary_of_a_layer_without_extent_moves_as_a_finite_difference(lower: bool) -> None:
    """Toward where the layer has an extent."""
    rules, step = ModelOptions(tolerance=1e-11), 1e-4 if lower else -1e-4

    def make_tissue(move: float) -> Tissue:
        boundaries = [9.37, 9.37 + move] if lower else [9.37 + move, 9.37]
        return Tissue(mu=[0.2, 33, 1], alpha=[1, -1, 2], boundaries=boundaries)

    at = [simulate(NEEDLE, make_tissue(n * step), Bevel(0.085), 20.0, rules=rules).u for n in range(3)]
    slope = (-3 * at[0] + 4 * at[1] - at[2]) / (2 * step)
    _, found = linearize(NEEDLE, make_tissue(0.0), Bevel(0.085), 20.0, rules=rules, wrt=("boundaries",))
    np.testing.assert_allclose(found.u[:, int(lower)], slope, rtol=0, atol=2e-5 * np.abs(slope).max())


def test_points_in_the_plane_move_as_finite_differences() -> None:
    controls = Controls(base_slope=0.01, guides=(Guide(-15.0, 0.2, None), Guide(4.6, 0.3, in_tissue=True)))
    rules = ModelOptions(tolerance=1e-11)
    shape, found = linearize(NEEDLE, PHANTOM, Bevel(0.15), 25.0, controls, rules, wrt=("offset", "guides"))
    s = np.array([-100.0, -15.5, -3.0, 0.0, 4.3, 4.9, 12.5, 25.0])
    moves = differentiate_positions(shape, found, s)
    assert moves.shape == (8, 2, 7)

    def points(offset: float = 0.0, before: float = 0.0, within: float = 0.0) -> np.ndarray:
        guides = (Guide(-15.0 + before, 0.2, None), Guide(4.6 + within, 0.3, in_tissue=True))
        moved_controls = Controls(base_slope=0.01, guides=guides)
        return compute_positions(
            simulate(NEEDLE, PHANTOM, Bevel(0.15 + offset), 25.0, moved_controls, rules), s
        )

    for column, name in ((0, "offset"), (1, "before"), (4, "within")):
        slope = (points(**{name: 1e-4}) - points(**{name: -1e-4})) / 2e-4
        assert np.abs(slope).max() > 1e-3
        np.testing.assert_allclose(moves[:, :, column], slope, rtol=0, atol=2e-5 * np.abs(slope).max())


def test_failed_needles_and_unknown_kinds_have_no_derivatives_and_every_input_is_listed():
    shape, found = linearize(NEEDLE, Tissue(mu=[0.2], alpha=[1.0], thickness=[0.05]), Bevel(0.2), 10.0)
    assert shape.status == "over-compressed"
    assert found.u.shape == (len(shape.x), 3) and found.constraints.shape == (11, 3)
    assert all(np.isnan(part).all() for part in (found.x, found.u, found.slope, found.constraints))
    with pytest.raises(ModelError, match="`depth`"):
        linearize(NEEDLE, PHANTOM, Bevel(0.1), 10.0, wrt=("mu", "depth"))
    inputs = {f"{of.__name__}.{one.name}" for of in (Needle, Tissue, Bevel, Controls) for one in fields(of)}
    assert inputs == KIND_OF.keys() | NO_KIND
    assert set(DERIVATIVE_KINDS) == set(KIND_OF.values())


KIND_OF = {
    "Needle.flexural_rigidity": "rigidity", "Tissue.mu": "mu", "Tissue.shape": "shape",
    "Tissue.friction": "friction", "Tissue.boundaries": "boundaries", "Bevel.offset": "offset",
    "Bevel.cut_angle": "cut_angle", "Controls.base_y": "base_y", "Controls.base_slope": "base_slope",
    "Controls.stage_slope": "stage_slope", "Controls.guides": "guides",
}  # fmt: skip
NO_KIND = {"Needle.length", "Tissue.thickness", "Tissue.law", "Bevel.side", "Controls.tip"}
