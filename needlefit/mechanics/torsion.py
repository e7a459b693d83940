"""The roll of the tip, which stays behind that of the hub (docs/model.md, section 8).

Friction on the inserted shaft holds a turning needle back, and the needle twists. Within the lag the tip does
not follow the hub. It depends on depths and inputs alone, so the solvers read the steps as the tip turns.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from needlefit.mechanics.control import Bevel, Step
from needlefit.mechanics.needle import Needle, require_type
from needlefit.mechanics.tissue import Tissue

POISSON_RATIO = 0.3  #: Poisson's ratio nu of the needle: its torsional rigidity is GJ = EI / (1 + nu)


def compute_roll_lag(needle: Needle, tissue: Tissue, depth: float) -> float:
    """Return by how much the tip may stay behind the hub, degrees, with `depth` (mm) inserted."""
    torsional_rigidity = needle.flexural_rigidity / (1 + POISSON_RATIO)
    twisted_length = depth / 2 + (needle.length - depth)
    return math.degrees(tissue.torsional_friction * depth / torsional_rigidity * twisted_length)


def turn_tip(needle: Needle, tissue: Tissue, steps: Sequence[Step]) -> tuple[Step, ...]:
    """Return the steps with the roll of the tip in place of the hub's; at first contact the two are alike.

    Raises ModelError if an argument is of another type.
    """
    require_type("needle", needle, Needle)
    require_type("tissue", tissue, Tissue)
    require_type("steps", steps, Sequence)
    for step in steps:
        require_type("a step", step, Step)
    if tissue.torsional_friction == 0:
        return tuple(steps)
    turned, roll, depth = list[Step](), 0.0, 0.0
    for step in steps:
        bevel = follow_hub(needle, tissue, step.bevel, roll, min(depth, step.depth))
        turned.append(replace(step, bevel=bevel))
        roll, depth = find_roll(bevel), step.depth
    return tuple(turned)


def follow_hub(needle: Needle, tissue: Tissue, hub: Bevel, roll: float, depth: float) -> Bevel:
    """Return the bevel with the roll that the tip takes on, which was `roll`, degrees.

    The hub turns while the tip stands at `depth`, mm, or the tip has been retracted to there.
    """
    aim, lag = find_roll(hub), compute_roll_lag(needle, tissue, depth)
    reached = min(max(roll, aim - lag), aim + lag)
    return hub if reached == aim else replace(hub, roll_deg=hub.roll_deg + (reached - aim))


def find_roll(bevel: Bevel) -> float:
    """Return the roll of a bevel, degrees: 0 toward +y, 180 of a bevel of side -1."""
    return bevel.roll_deg + (0.0 if bevel.side > 0 else 180.0)
