"""The shortest way to where a needle stands: what it did and took back left nothing behind."""

from collections.abc import Callable
from dataclasses import replace

from needlefit.mechanics.control import Bevel, Controls, Step
from needlefit.mechanics.plan import Lattice, Position, Ray, rays


def course(
    position: Position, last: Step, lattice: Lattice, meant: Callable[[Ray], tuple[Bevel, Controls]]
) -> tuple[Step, ...]:
    """Return steps that lead from first contact to where the needle stands: same rays, same inputs.

    Parameters
    ----------
    position : Position
    last : Step
        Where the tip stands, and under which inputs.
    lattice : Lattice
    meant : callable
        The bevel that cuts a ray, and the controls under which it was begun.
    """
    steps: list[Step] = []
    cut = rays(position)
    ends = [ray.start for ray in cut[1:]] + [last.depth] * bool(cut)  # before the first cell there are none
    for ray, end in zip(cut, ends, strict=True):
        step = Step(end, *meant(ray))
        if not steps or lattice.at(lattice.cell(ray.start), ray.start):
            if steps and (steps[-1].bevel, steps[-1].controls) == (step.bevel, step.controls):
                steps.pop()  # at a constraint point a new ray begins of itself
        elif (steps[-1].bevel, steps[-1].controls) == (step.bevel, step.controls):
            steps.append(_turned(steps[-1]))  # within a cell only changed inputs begin one
        steps.append(step)
    if not steps or (steps[-1].bevel, steps[-1].controls) != (last.bevel, last.controls):
        steps.append(last)
    elif position.turned:
        steps += [_turned(last), last]
    return tuple(steps)


def _turned(step: Step) -> Step:
    """Return a step to the same place that turns the bevel over: so inputs have changed, and nothing else."""
    return replace(step, bevel=replace(step.bevel, side=-step.bevel.side))
