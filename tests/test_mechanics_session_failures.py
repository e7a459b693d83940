"""What a session does where a step cannot be done: it says why, and stays as it was."""

from collections import Counter
from functools import partial

import numpy as np
import pytest
from mechanics_cases import NEEDLE, assert_same_bits

from needlefit.errors import ModelError
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, TrackedTip
from needlefit.mechanics.session import Session
from needlefit.mechanics.tissue import Tissue

TISSUE = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])
THIN = Tissue(mu=[0.5], alpha=[8.0], thickness=[2.0])
LEFT, RIGHT = Bevel(0.1, 1), Bevel(0.1, -1)
assert_same_steps = partial(assert_same_bits, but=("iterations",))  # each step counts its own


@pytest.mark.parametrize(
    "step",
    [
        {"insert": 3.3, "base": (0.5, 0.0), "tip": TrackedTip(-3.0)},
        {"insert": -2.1, "tip": TrackedTip(5.0)},
        {"insert": 20.0, "bevel": Bevel(5.0)},
        {"guides": tuple(Guide(-float(n), 9.0 * (n % 2)) for n in range(1, 12))},  # more than ever before
    ],
)
def test_a_failed_step_changes_nothing(step: dict) -> None:
    """Each of these compresses tissue of 2 mm to nothing; the needle stays where and as it was."""
    under_way, untouched = Session(NEEDLE, THIN, LEFT, 0.7), Session(NEEDLE, THIN, LEFT, 0.7)
    for one in (under_way, untouched):
        one.step(5.4)
        one.step(-0.9)
    for _ in range(2):
        failed = under_way.step(**step)
        assert failed.status == "over-compressed" and np.isnan(failed.u).all()
        assert failed.depth == pytest.approx(4.5 + step.get("insert", 0.0))
        assert under_way.last == untouched.last and under_way.depth == 4.5
    assert under_way.failures == Counter({"over-compressed": 2})
    for after in ({"insert": 0.3}, {"insert": 4.0, "bevel": RIGHT}, {"insert": -2.0}, {"base": (0.1, 0)}):
        assert_same_steps(under_way.step(**after), untouched.step(**after))


def test_failures_are_counted_by_reason() -> None:
    under_way = Session(NEEDLE, THIN, Bevel(0.05), rules=ModelOptions(max_iterations=4))
    assert under_way.step(5.4).converged
    assert under_way.step(base=(30.0, 0.0)).status == "not converged"
    for _ in range(2):
        assert under_way.step(base=(100.0, 0.0)).status == "over-compressed"
    assert under_way.failures == Counter({"over-compressed": 2, "not converged": 1})
    assert under_way.step(1.0).converged and under_way.depth == 6.4


def test_a_needle_that_fails_at_once_stays_at_the_entry() -> None:
    tissue = Tissue(mu=[1.0], alpha=[1e15])
    under_way = Session(NEEDLE, tissue, LEFT)
    assert under_way.step(3.0).status == "non-finite"
    assert under_way.depth == 0.0 and under_way.step().converged


@pytest.mark.parametrize(
    "step",
    [
        {"insert": -5.0},
        {"insert": np.nan},
        {"insert": 200.0},
        {"insert": 1.0, "guides": (Guide(-146.0),)},
        {"base": (np.nan, 0.0)},
        {"guides": (Guide(-3.0), Guide(-3.0, 0.1))},
    ],
)
def test_bad_inputs_are_refused_and_change_nothing(step: dict) -> None:
    under_way, untouched = Session(NEEDLE, TISSUE, LEFT), Session(NEEDLE, TISSUE, LEFT)
    for one in (under_way, untouched):
        one.step(3.4)
    with pytest.raises(ModelError):
        under_way.step(**step)
    assert under_way.depth == 3.4 and not under_way.failures
    assert_same_steps(under_way.step(2.0), untouched.step(2.0))


def test_a_guide_out_of_reach_is_refused_from_the_start() -> None:
    with pytest.raises(ModelError, match="through a guide 151 mm"):
        Session(NEEDLE, TISSUE, LEFT, controls=Controls(guides=(Guide(-151.0),)))
