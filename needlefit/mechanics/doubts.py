"""Warn of numbers given in Python that are most likely in another unit, as is warned of those in files."""

import math
from collections.abc import Iterator, Sequence

from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue
from needlefit.project.result_warnings import issue_warnings
from needlefit.project.unit_warnings import (
    CUT_ANGLE_DEG,
    Doubt,
    doubt_alpha,
    doubt_depth,
    doubt_mu,
    doubt_offset,
    doubt_range,
    doubt_rigidity,
    doubt_tops,
    warn,
)

CUT_ANGLE_RAD = (math.radians(CUT_ANGLE_DEG[0]), math.radians(CUT_ANGLE_DEG[1]))
# smallest depth that is assumed where none is stated, as a fraction of the needle's length
OPEN_DEPTH_PART = 1 / 3


def warn_of_units(
    needle: Needle, tissue: Tissue, steps: Sequence[Step], rules: ModelOptions, *, is_open: bool = False
) -> None:
    """Issue a UserWarning for each value of an insertion that no needle or tissue has.

    Values that a file states, or a fit varies, were judged there. `is_open`: whether more steps follow, so
    that the depth is not known.
    """
    if not tissue.is_checked:
        doubts = _doubt_insertion(needle, tissue, steps, rules, is_open)
        issue_warnings(warn(doubts, str), stacklevel=4)


def _doubt_insertion(
    needle: Needle, tissue: Tissue, steps: Sequence[Step], rules: ModelOptions, is_open: bool
) -> Iterator[Doubt]:
    yield from doubt_rigidity(needle.flexural_rigidity, "flexural_rigidity")
    deepest = max((step.depth for step in steps), default=0.0)
    if is_open:
        deepest = max(deepest, OPEN_DEPTH_PART * needle.length)
    yield from doubt_depth(deepest, needle.length, "depth")
    yield from doubt_tops(tissue.boundaries.tolist(), deepest, "boundaries")
    for mu in dict.fromkeys(tissue.mu.tolist()):
        yield from doubt_mu(1e6 * mu, "mu")
    for alpha in dict.fromkeys(tissue.alpha.tolist() if tissue.law == "ogden" else ()):
        yield from doubt_alpha(alpha, tissue.law, "alpha")
    for offset, angle in dict.fromkeys((step.bevel.offset, step.bevel.cut_angle) for step in steps):
        yield from doubt_offset(offset, rules.spacing, "offset")
        if angle:
            yield from doubt_range(angle, CUT_ANGLE_RAD, {"degrees": math.radians(1)}, "cut_angle", "rad")
