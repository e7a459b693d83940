"""The checks of `needlefit verify` pass on this solver, and fail on one with a fault in it."""

import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from refusals import refusal

from needlefit.mechanics import packing, reference, simulate
from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.laws import list_shape_parameters
from needlefit.mechanics.simulate import simulate_steps
from needlefit.verification import cases
from needlefit.verification.check import (
    AcceptanceBound,
    Check,
    CheckOutcome,
    ConvergenceCurve,
    Group,
    Quantity,
    at_most,
    find_checks,
    verify,
    within,
    worst,
)
from needlefit.verification.checks import (
    beams,
    compiled,
    scenes,
    sensitivities,
    symmetries,
)
from needlefit.verification.checks.beams import hetenyi
from needlefit.verification.checks.clamped import DEPTH_MM, FREE_LENGTH_MM, make_deflection

CLOSED_FORMS, MANUFACTURED, COLLOCATION = Group.CLOSED_FORMS, Group.MANUFACTURED, Group.COLLOCATION
SYMMETRIES, TANGENT = Group.SYMMETRIES, Group.TANGENT


def select(group):
    return [check for check in find_checks() if check.group is group]


def failing(group):
    """Return the titles of the rows that fail among the checks of a group."""
    return {row.title for row in verify(1, select(group)).failed}


def titles(group):
    return {check.title for check in select(group)}


# ---- the table ----


REFERENCE = {}
"""Derivatives by the reference, by the case: faults are planted into the solver and leave these alone."""


def differentiate_once(case, differentiate=sensitivities.differentiate_reference):
    key = pickle.dumps(case)
    if key not in REFERENCE:
        REFERENCE[key] = differentiate(case)
    return REFERENCE[key]


SHAPE = tuple({one.name for one in list_shape_parameters()})


def few(monkeypatch):
    """Draw fewer of the random cases that take longest, and differentiate the reference in each once."""
    monkeypatch.setattr(sensitivities, "differentiate_reference", differentiate_once)
    monkeypatch.setattr(sensitivities, "RANDOM_CASES", 2)
    monkeypatch.setattr(scenes, "RANDOM_CASES", 10)


def test_titles_differ_and_orders_of_a_power_law_are_its_exponent():
    checks = find_checks()
    assert len({(check.group, check.title) for check in checks}) == len(checks)
    h = (4.0, 2.0, 1.0)
    curve = ConvergenceCurve("x^3", h, {"u": tuple(0.7 * x**3 for x in h)})
    assert curve.order("u") == pytest.approx(3)
    assert curve.orders("u") == pytest.approx([3, 3])


@pytest.mark.sweep
def test_the_same_seed_measures_the_same_and_another_one_other_cases():
    some = [check for check in compiled.CHECKS if "12 random" in check.title]
    first, again, other = (verify(seed, some).rows[0].measured for seed in (3, 3, 4))
    assert first == again != other


def test_a_check_that_crashes_is_a_failed_row_with_its_reason_and_the_next_one_goes_on():
    def crash(rng):
        raise ZeroDivisionError("no\nluck")

    quantities = (Quantity("a", at_most(1.0), "mm"), Quantity("b", AcceptanceBound(), ""))
    bad = Check(TANGENT, "bad", quantities, crash)
    good = Check(TANGENT, "good", quantities, lambda rng: CheckOutcome((0.5, 7.0)))
    found = verify(1, [bad, good])
    assert [row.verdict for row in found.rows] == ["FAILS", "FAILS", "passes", "stated"]
    assert found.rows[0].remark.endswith("ZeroDivisionError: no luck")
    assert "test_verification.py" in found.traces[0]


def test_verdicts_and_the_worst_of_values():
    for bound, value, verdict in [
        (at_most(1e-6), 1e-6, "passes"),
        (at_most(1e-6), 1.01e-6, "FAILS"),
        (within(4, 0.2), 3.79, "FAILS"),
        (within(4, 0.2), 4.21, "FAILS"),
        (within(4, 0.2), 4.1, "passes"),
        (AcceptanceBound(), 3.0, "stated"),
        (AcceptanceBound(), float("nan"), "FAILS"),
        (at_most(1.0), float("-inf"), "FAILS"),
    ]:
        assert bound.verdict(value) == verdict
    for values in ([np.nan, 1.0], [1.0, np.nan], np.array([0.0, np.nan, 2.0])):
        assert np.isnan(worst(values))
    assert worst((1.0, 3.0, 2.0)) == 3.0
    refusal(ValueError, "zero-size", worst, [])


# ---- what the checks measure against ----


def test_formulas_of_beams_agree_where_both_hold():
    rigidity, k = 1e4, 30.0
    beta = (k / (4 * rigidity)) ** 0.25
    x = np.linspace(0, 20, 7)
    found = hetenyi(rigidity, np.array([k]), np.array([0.0, np.inf]), 1e-6)(x)
    np.testing.assert_allclose(found, np.exp(-beta * x) * (np.cos(beta * x) + np.sin(beta * x)), atol=1e-6)
    x = np.linspace(0, 40, 9)
    one = hetenyi(1e4, np.array([5.0]), np.array([0.0, 40.0]), 20.0)(x)
    two = hetenyi(1e4, np.array([5.0, 5.0]), np.array([0.0, 11.0, 40.0]), 20.0)(x)
    np.testing.assert_allclose(one, two, atol=1e-10)
    # A uniform load all along: the prop at the tip carries 3 q L / 8.
    tip = np.array([cases.PAPER_NEEDLE.length])
    reaction = beams.cantilever_deflection(tip, 0.0) / beams.prop_deflection(tip, cases.PAPER_NEEDLE.length)
    assert reaction == pytest.approx(3 / 8 * beams.LOAD * cases.PAPER_NEEDLE.length)


def test_the_chosen_deflection_and_the_reaction_by_hand():
    chosen = make_deflection(np.array([17.37]))
    for order in range(4):
        for x in (0.0, 17.37):
            below, above = (float(chosen.at(np.array([x + d]), order)[0]) for d in (-1e-9, 1e-9))
            assert below == pytest.approx(above, abs=1e-9)
    base, tip = np.array([-FREE_LENGTH_MM]), np.array([DEPTH_MM])
    for x, order in ((base, 0), (base, 1), (tip, 2), (tip, 3)):
        assert chosen.at(x, order)[0] == pytest.approx(0, abs=1e-12)
    assert abs(float(np.diff(chosen.at(np.array([17.36999, 17.37001]), 4))[0])) > 1e-6
    # alpha = 3, mu = 1, lambda = 1/4: k = 32.125 (see the model's tests); here e = 3 of t = 4 mm.
    law, layer = cases.ReferenceLaw.of(cases.make_tissue([1.0], [3.0], thickness=[4.0])), np.array([0])
    e, level = np.array([3.0]), np.array([0.0])
    assert law.reaction(layer, e, level)[0] == pytest.approx(3 * 32.125)
    assert law.reaction(layer, -e, level)[0] == pytest.approx(-3 * 32.125)
    assert law.deflection_of(layer, np.array([-96.375]), level)[0] == pytest.approx(-3.0)


# ---- faults: each is planted into the solver, and the right rows fail ----


def stiffer(tissue):
    return replace(tissue, mu=1.01 * tissue.mu)


CURVED = {COLLOCATION: "Thin", MANUFACTURED: "Ogden|The same", TANGENT: "."}
FAULTS = [  # a fault of the tissue that the kernel reads, the checks of a group that fail, and that pass
    (
        stiffer,
        {CLOSED_FORMS: ".", MANUFACTURED: ".", COLLOCATION: ".", Group.REFERENCE: "insertions|schedules"},
        {},
    ),
    (
        lambda tissue: replace(tissue, law=tissue.law.replace("neo_hookean", "ogden")),
        {MANUFACTURED: "neo-Hookean", COLLOCATION: "Neo-Hookean"},
        {COLLOCATION: "^(?!.*Neo-Hookean)"},
    ),
    *(
        (change, CURVED, {CLOSED_FORMS: ".", MANUFACTURED: "One layer, linear law"})
        for change in (lambda t: replace(t, shape=-t.shape), lambda t: replace(t, law="linear"))
    ),
    (
        lambda tissue: replace(tissue, friction=0 * tissue.friction),
        {COLLOCATION: "Friction", TANGENT: "friction", MANUFACTURED: "The same with friction"},
        {COLLOCATION: "^(?!.*Friction)", TANGENT: "^(?!.*friction)"},
    ),
]


@pytest.mark.sweep
@pytest.mark.parametrize(("change", "fail", "hold"), FAULTS)
def test_a_fault_fails_the_checks_that_it_concerns(change, fail, hold, monkeypatch):
    true = packing.pack_layers
    monkeypatch.setattr(packing, "pack_layers", lambda tissue, *rest: true(change(tissue), *rest))
    for group in fail | hold:
        failed = failing(group)
        assert failed >= {title for title in titles(group) if re.search(fail.get(group, "$^"), title)}
        assert not {title for title in failed if re.search(hold.get(group, "$^"), title)}


def test_a_load_that_the_shape_does_not_bear_is_noticed(monkeypatch):
    true = simulate.pack_equilibrium
    monkeypatch.setattr(
        simulate, "pack_equilibrium", lambda needle, tissue, *rest: true(needle, stiffer(tissue), *rest)
    )
    assert verify(1, [check for check in symmetries.CHECKS if "balance" in check.title]).failed


def test_an_unsymmetric_bevel_is_noticed(monkeypatch):
    def lopsided(needle, tissue, steps, rules=ModelOptions(), lattice=None):
        bent = [
            replace(step, bevel=Bevel(step.bevel.offset * (1 + 1e-6 * step.bevel.side), step.bevel.side))
            for step in steps
        ]
        return simulate_steps(needle, tissue, bent, rules, lattice)

    monkeypatch.setattr("needlefit.verification.cases.simulate_steps", lopsided)
    assert any("Mirror" in title for title in failing(SYMMETRIES))


@pytest.mark.sweep
def test_a_jacobian_one_part_in_a_million_wrong_is_noticed(monkeypatch):
    true = sensitivities.linearize_steps

    def wrong(*arguments, **named):
        shape, jacobian = true(*arguments, **named)
        return shape, replace(jacobian, u=jacobian.u * (1 + 5e-7))

    monkeypatch.setattr(sensitivities, "linearize_steps", wrong)
    few(monkeypatch)
    failed = verify(1, sensitivities.CHECKS[:2]).failed
    assert len(failed) == 6


@pytest.mark.sweep
def test_a_reference_that_differs_is_noticed(monkeypatch):
    true = reference.modulus

    def wrong(*arguments):
        k, dk = true(*arguments)
        return 1.001 * k, 1.001 * dk

    monkeypatch.setattr(reference, "modulus", wrong)
    assert failing(Group.REFERENCE) == titles(Group.REFERENCE) - {
        check.title for check in compiled.LAW_CHECKS
    }
    assert failing(TANGENT) == titles(TANGENT)


# ---- what is no number passes nowhere ----


def with_jacobian(monkeypatch, change):
    true = sensitivities.linearize_steps

    def wrong(*arguments, **named):
        return change(*true(*arguments, **named))

    monkeypatch.setattr(sensitivities, "linearize_steps", wrong)
    few(monkeypatch)
    return verify(1, sensitivities.CHECKS[:1])


@pytest.mark.parametrize(
    ("prefix", "quantity"), [("offset", "other columns"), ("boundary", "places"), (SHAPE, "shape")]
)
@pytest.mark.parametrize("part", ["u", "slope", "constraints"])
def test_a_column_without_a_number_fails_its_quantity(prefix, quantity, part, monkeypatch):
    def blank(shape, jacobian):
        values = getattr(jacobian, part).copy()
        values[-1, [name.startswith(prefix) for name in jacobian.names].index(True)] = np.nan
        return shape, replace(jacobian, **{part: values})

    (failed,) = with_jacobian(monkeypatch, blank).failed
    assert quantity in failed.quantity and np.isnan(failed.measured)
