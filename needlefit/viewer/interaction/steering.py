"""A needle that is simulated step by step as inputs change, and can return to earlier states."""

import math
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

from needlefit.errors import ModelError
from needlefit.mechanics.control import Controls, Step
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.scene import Scene, begin_session
from needlefit.mechanics.session import NeedleState, Session
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.tissue import Tissue
from needlefit.viewer.interaction.inputs import Change, apply_changes, is_parameter

TRIAL_SECONDS, TRIALS = 0.008, 3
"""Duration of a trial, s, and number of trials; the fastest counts, since other programs can only slow a
trial down."""

BASE_CLEARANCE_MM = 5.0
"""The base stops so far before the first guide, mm: a span of less than about four diameters is no beam."""


def measure_step_rate(session: Session, depth: float) -> float:
    """Return the number of steps per second that a needle can compute near `depth` (mm), with no other work.

    A step moves the tip by a constraint spacing, in and out alternately. Between the
    frames of a page the processor sleeps and forgets, and single steps take a few times as long.
    """
    other = session.copy()
    inputs, spacing = session.last, session.rules.spacing
    steps = [Step(place, inputs.bevel, inputs.controls) for place in (max(depth - spacing, 0.0), depth)]
    other.go(steps[1])
    return max(_measure_once(other, steps) for _ in range(TRIALS))


def _measure_once(session: Session, steps: list[Step]) -> float:
    before, began = session.solved, perf_counter()
    while (spent := perf_counter() - began) < TRIAL_SECONDS:
        for step in steps:
            session.go(step)
    return (session.solved - before) / spent


class SteeredNeedle:
    """The needle of a scene, simulated step by step from first contact on.

    The same changes in the same order find the same bits.

    Parameters
    ----------
    scene : Scene
        Its needle, tissue and entry, and what holds the needle as its first step begins.
    first_cell : float
        Depth of the first constraint point, mm.
    valid_only : bool
        Whether a step that leads outside the model's validity is refused.

    Attributes
    ----------
    number : int
        Steps so far; 0 at first contact.
    solved : int
        Equilibria solved in them.
    failed : int
        Steps that were refused, as no needle was found.
    """

    def __init__(self, scene: Scene, first_cell: float, *, valid_only: bool = False) -> None:
        self._valid_only = valid_only
        self.names = list_guide_names(scene)
        self.scene = replace(scene, steps=tuple(_with_guide_names(step) for step in scene.steps))
        self.number, self.solved, self.failed = 0, 0, 0
        self._session = begin_session(self.scene, first_cell)
        self._saved: dict[int, Session] = {}
        self.keep()

    @property
    def now(self) -> NeedleState:
        """The present state of the needle."""
        return self._session.now

    @property
    def first_cell(self) -> float:
        """Depth of the first constraint point, mm."""
        return self._session.lattice.first_cell

    def input_path(self) -> tuple[Step, ...]:
        """Return the shortest steps that lead to the present state."""
        return self._session.input_path()

    def step_rate(self) -> float:
        """Return the steps per second that this needle can compute at the final depth of its scene."""
        return measure_step_rate(self._session, min(self.scene.depth, self.reach()))

    def reach(self) -> float:
        """Return the greatest depth possible now, mm: the base is then just before guides or tissue."""
        return self._reach_under(self.now.step.controls)

    def _reach_under(self, controls: Controls) -> float:
        """Return the greatest depth possible under these controls, mm."""
        before = controls.before
        # 1e-6 mm less: the base must stay before guides and tissue.
        return self.scene.needle.length + (before[0].x - BASE_CLEARANCE_MM if before else 0.0) - 1e-6

    def apply(self, changes: Sequence[Change]) -> NeedleState:
        """Carry out one step: all changes at once.

        Raises
        ------
        ModelError
            If the model does not take them, or finds no needle that does; then nothing has happened.
        """
        _check_together(changes)
        if changes and changes[0].name == "return_to":
            # A copy: the stored state must survive further steps, for another return.
            self._session = self._saved_at(int(changes[0].value)).copy()
        else:
            self._session = self._advance(changes)
        self.number += 1
        return self.now

    def keep(self) -> None:
        """Store the present state, for a later return to it."""
        self._saved[self.number] = self._session.copy()

    def forget(self, number: int) -> None:
        """Delete the state stored at a step; the initial state stays."""
        if number:
            self._saved.pop(number, None)

    def _saved_at(self, number: int) -> Session:
        if number not in self._saved:
            raise ModelError(f"nothing was kept of step {number}", expected="a step to return to")
        return self._saved[number]

    def _advance(self, changes: Sequence[Change]) -> Session:
        """Return the session after a step; the one there is stays as it was if that fails."""
        session, before = self._session, self._session.solved
        parameters = [change for change in changes if is_parameter(change.name)]
        if parameters:
            session = self._recompute(parameters)
            before = 0
        moved = [change for change in changes if not is_parameter(change.name)]
        step = apply_changes(session.last, moved, self.names, float(session.now.shape.u[-1]))
        if step != session.last:
            if self._valid_only:
                self._require_clearance(step)
            shape = session.go(step, valid_only=self._valid_only)
            if not shape.converged:
                self.failed += 1
                raise ModelError(
                    f"the model finds no needle there ({shape.status})",
                    expected="a load that tissue and needle can bear",
                    fix="move less at a time",
                )
            self._require_valid(shape)
        self.solved += session.solved - before
        return session

    def _recompute(self, parameters: Sequence[Change]) -> Session:
        given = {change.name: change.value for change in parameters}
        angle = given.get("cut_angle_throughout_deg")
        session = self._session.simulate_again(
            _with_parameters(self._session.tissue, parameters),
            given.get("offset_throughout_mm"),
            None if angle is None else math.radians(angle),
        )
        if session.failures:
            self.failed += 1
            raise ModelError(
                f"with these parameters the insertion so far fails {session.depth:.1f} mm deep",
                expected="a load that tissue and needle can bear",
                fix="change them less, or retract the needle first",
            )
        self._require_valid(session.now.shape)
        return session

    def _require_clearance(self, step: Step) -> None:
        """Raise ModelError where the base would come closer to the first guide than `BASE_CLEARANCE_MM`."""
        if step.controls.before and step.depth > self._reach_under(step.controls) + 1e-6:
            gap = step.controls.before[0].x + self.scene.needle.length - step.depth
            raise ModelError(
                f"the base would stand {gap:.2f} mm before the first guide",
                expected=f"at least {BASE_CLEARANCE_MM:g} mm: the base stops at the guide",
                fix="retract the needle, or move the guide toward the tissue",
            )

    def _require_valid(self, shape: NeedleShape) -> None:
        """Raise ModelError where a needle would leave the model's validity, unless it is outside already."""
        if self._valid_only and not shape.valid and self.now.shape.valid:
            self.failed += 1
            raise ModelError(
                f"the needle would be outside the model's validity: {'; '.join(shape.validity.faults)}",
                expected="a needle within the limits of small deflections",
                fix="move less, or bring base, guides and tip nearer to the needle's own shape",
            )


def _check_together(changes: Sequence[Change]) -> None:
    """Raise ModelError unless changes can act together: one value for each input, a return by itself."""
    inputs = [(change.name, change.item) for change in changes]
    for name, item in inputs:
        if inputs.count((name, item)) > 1:
            raise ModelError(f"{name} has two values in one step", expected="one value for each input")
        if name == "return_to" and len(inputs) > 1:
            raise ModelError("return_to stands beside other inputs", expected="a step of its own")


def list_guide_names(scene: Scene) -> tuple[str, ...]:
    """Return the names of the guides of a scene, in the order of their numbers."""
    guides = [guide for step in scene.steps for guide in step.controls.guides]
    return tuple(dict.fromkeys(guide.name or "guide" for guide in guides))


def _with_guide_names(step: Step) -> Step:
    """Return a step whose guides all have a name."""
    guides = tuple(replace(guide, name=guide.name or "guide") for guide in step.controls.guides)
    return replace(step, controls=replace(step.controls, guides=guides))


def _with_parameters(tissue: Tissue, parameters: Sequence[Change]) -> Tissue:
    """Return the tissue with other moduli (Pa in the changes, MPa in the tissue) and shape parameters."""
    mu, shape = tissue.mu.copy(), tissue.shape.copy()
    names = LAWS[tissue.law].shape_names
    for change in parameters:
        if change.item is None:
            continue
        if change.item > tissue.layers:
            raise ModelError(
                f"there is no layer {change.item!s:.20}", expected=f"one of {tissue.layers} layers"
            )
        if change.name == "mu_pa":
            mu[change.item - 1] = change.value * 1e-6
        elif change.name in names:
            shape[names.index(change.name), change.item - 1] = change.value
        else:
            raise ModelError(
                f"the tissue law `{tissue.law}` has no {change.name}", expected=", ".join(["mu_pa", *names])
            )
    return replace(tissue, mu=mu, shape=shape)
