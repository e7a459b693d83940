"""Limits of an insertion: how many elements it may solve for, and how deep a needle can go."""

from functools import lru_cache

from needlefit.errors import ModelError
from needlefit.mechanics.control import Controls, ModelOptions
from needlefit.schemas.limits import MAX_ELEMENT_SOLVES, MAX_ELEMENTS


@lru_cache(maxsize=512)  # a fit asks for the same insertions over and over
def count_element_solves(depths: tuple[float, ...], spacing: float, element: float) -> float:
    """Estimate the number of elements an insertion solves for; the true number is not larger.

    On the way in the tip halts once in every cell, else once or twice a step; each halt solves for the
    elements between entry and tip.
    """
    total, here = 0.0, 0.0
    for depth in depths:
        cells = max(depth - here, 0.0) / spacing + 2
        total += cells * (max(depth, here) if depth <= here else 0.5 * (depth + here)) / element + 2 * cells
        here = depth
    return total


def check_size(depths: tuple[float, ...], rules: ModelOptions) -> None:
    """Raise ModelError where an insertion to these depths (mm), in order, would take minutes or gigabytes."""
    deepest = max(depths, default=0.0)
    if deepest > MAX_ELEMENTS * rules.element:
        raise ModelError(
            f"{deepest:g} mm of depth are {deepest / rules.element:.0f} elements of {rules.element:g} mm",
            expected=f"at most {MAX_ELEMENTS} elements",
            fix="insert less deep, or take a larger constraint spacing and longer elements",
        )
    solves = count_element_solves(depths, rules.spacing, rules.element)
    if solves > 1.01 * MAX_ELEMENT_SOLVES:  # the deepest insertion is allowed, whatever its first cell
        raise ModelError(
            f"{len(depths)} steps are {solves:.3g} elements to be solved for in all equilibria",
            expected=f"at most {MAX_ELEMENT_SOLVES:.3g}",
            fix="take fewer steps, insert less deep, or take a larger constraint spacing",
        )


def check_reach(length: float, depth: float, controls: Controls) -> None:
    """Raise ModelError unless a needle of `length` reaches `depth` with its base before guides and tissue."""
    guides = controls.guides  # from the base inwards
    before = -guides[0].x if guides and not guides[0].in_tissue else 0.0
    if depth + before < length:
        return
    needle = f"a needle of {length:g} mm"
    through = f" through a guide {before:g} mm before the tissue" if before else ""
    nearer = (
        f", or a guide less than {length - depth:g} mm before the tissue" if before and depth < length else ""
    )
    if before >= length:
        raise ModelError(
            f"{needle} does not even reach the tissue{through}",
            expected=f"a needle longer than {depth + before:g} mm to go {depth:g} mm deep{nearer}",
            fix="give the needle's true length, or move the guide toward the tissue",
        )
    raise ModelError(
        f"{needle} cannot be inserted {depth:g} mm{through}",
        expected=f"a depth below {length - before:g} mm{nearer}",
        fix=f"lessen the depth,{' move the guide,' if nearer else ''} or give the needle's true length",
    )
