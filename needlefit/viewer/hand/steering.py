"""A needle in somebody's hand: changes come in, the needle goes on, and may go back."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needlefit.errors import ModelError
from needlefit.mechanics.control import Step
from needlefit.mechanics.scene import Scene, at_contact
from needlefit.mechanics.session import Moment, Session
from needlefit.mechanics.tissue import Tissue
from needlefit.viewer.hand.inputs import PARAMETERS, Change, changed
from needlefit.viewer.hand.speed import sustained


class Steering:
    """The needle of a scene from first contact on, step by step, as changes come.

    The same changes in the same order find the same bits.

    Parameters
    ----------
    scene : Scene
        Its needle, tissue and entry, and what holds the needle as its first step begins.
    first_cell : float
        Depth of the first constraint point, mm.

    Attributes
    ----------
    number : int
        Steps so far; 0 at first contact.
    solved : int
        Equilibria solved in them.
    failed : int
        Steps that were refused, as no needle was found.
    """

    def __init__(self, scene: Scene, first_cell: float) -> None:
        self.names = names_of(scene)
        self.scene = replace(scene, steps=tuple(_named(step) for step in scene.steps))
        self.number, self.solved, self.failed = 0, 0, 0
        self._session = at_contact(self.scene, first_cell)
        self._kept: dict[int, Session] = {}
        self.keep()

    @property
    def now(self) -> Moment:
        """The needle as it stands."""
        return self._session.now

    @property
    def first_cell(self) -> float:
        """Depth of the first constraint point, mm."""
        return self._session.lattice.first_cell

    def course(self) -> tuple[Step, ...]:
        """Return the shortest steps that lead to where the needle stands."""
        return self._session.course()

    def speed(self) -> float:
        """Return how many steps a second this needle can make, at the depth that the scene ends at."""
        return sustained(self._session, min(self.scene.depth, self.reach()))

    def reach(self) -> float:
        """Return how deep the needle can go as it is held now, mm; the base then almost touches."""
        before = self.now.step.controls.before
        return self.scene.needle.length + (before[0].x if before else 0.0) - 1e-6

    def apply(self, changes: Sequence[Change]) -> Moment:
        """Carry out one step: all changes together.

        Raises
        ------
        ModelError
            If the model does not take them, or finds no needle that does; then nothing has happened.
        """
        _check_together(changes)
        if changes and changes[0].name == "return_to":
            self._session = self._kept_at(int(changes[0].value)).copy()
        else:
            self._session = self._gone_on(changes)
        self.number += 1
        return self.now

    def keep(self) -> None:
        """Make it possible to return to where the needle stands now."""
        self._kept[self.number] = self._session.copy()

    def forget(self, number: int) -> None:
        """Let go of what was kept at a step; the beginning stays."""
        if number:
            self._kept.pop(number, None)

    def _kept_at(self, number: int) -> Session:
        if number not in self._kept:
            raise ModelError(f"nothing was kept of step {number}", expected="a step to return to")
        return self._kept[number]

    def _gone_on(self, changes: Sequence[Change]) -> Session:
        """Return the session after a step; the one there is stays as it was if that fails."""
        session, before = self._session, self._session.solved
        parameters = [change for change in changes if change.name in PARAMETERS]
        if parameters:
            session = self._retold(parameters)
            before = 0
        moved = [change for change in changes if change.name not in PARAMETERS]
        step = changed(session.last, moved, self.names, float(session.now.shape.u[-1]))
        if step != session.last:
            shape = session.go(step)
            if not shape.converged:
                self.failed += 1
                raise ModelError(
                    f"the model finds no needle there ({shape.status})",
                    expected="a load that tissue and needle can bear",
                    mend="move less at a time",
                )
        self.solved += session.solved - before
        return session

    def _retold(self, parameters: Sequence[Change]) -> Session:
        offset = next((c.value for c in parameters if c.name == "offset_throughout_mm"), None)
        session = self._session.retold(_with(self._session.tissue, parameters), offset)
        if session.failures:
            self.failed += 1
            raise ModelError(
                f"with these parameters the insertion so far fails {session.depth:.1f} mm deep",
                expected="a load that tissue and needle can bear",
                mend="change them less, or retract the needle first",
            )
        return session


def _check_together(changes: Sequence[Change]) -> None:
    """Raise ModelError unless changes can act together: one value for each input, a return by itself."""
    inputs = [(change.name, change.item) for change in changes]
    for name, item in inputs:
        if inputs.count((name, item)) > 1:
            raise ModelError(f"{name} has two values in one step", expected="one value for each input")
        if name == "return_to" and len(inputs) > 1:
            raise ModelError("return_to stands beside other inputs", expected="a step of its own")


def names_of(scene: Scene) -> tuple[str, ...]:
    """Return what the guides of a scene are called, in the order of their numbers."""
    guides = [guide for step in scene.steps for guide in step.controls.guides]
    return tuple(dict.fromkeys(guide.name or "guide" for guide in guides))


def _named(step: Step) -> Step:
    """Return a step whose guides all have a name."""
    guides = tuple(replace(guide, name=guide.name or "guide") for guide in step.controls.guides)
    return replace(step, controls=replace(step.controls, guides=guides))


def _with(tissue: Tissue, parameters: Sequence[Change]) -> Tissue:
    """Return the tissue with other moduli (Pa in the changes, MPa in the tissue) and nonlinearities."""
    mu, alpha = np.array(tissue.mu), np.array(tissue.alpha)
    for change in parameters:
        if change.item is None:
            continue
        if change.item > tissue.layers:
            raise ModelError(
                f"there is no layer {change.item!s:.20}", expected=f"one of {tissue.layers} layers"
            )
        if change.name == "mu_pa":
            mu[change.item - 1] = change.value * 1e-6
        else:
            alpha[change.item - 1] = change.value
    return replace(tissue, mu=mu, alpha=alpha)
