"""Warn of numbers given in Python that are most likely in another unit, as is warned of those in files."""

from collections.abc import Iterator, Sequence

from needlefit.mechanics.control import Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue
from needlefit.project.result_warnings import issue_warnings
from needlefit.project.unit_warnings import Doubt, doubt_depth, doubt_rigidity, doubt_tops, warn


def warn_of_units(needle: Needle, tissue: Tissue, steps: Sequence[Step]) -> None:
    """Issue a UserWarning for each value of an insertion that no needle or tissue has."""
    issue_warnings(warn(_doubt_insertion(needle, tissue, steps), str), stacklevel=4)


def _doubt_insertion(needle: Needle, tissue: Tissue, steps: Sequence[Step]) -> Iterator[Doubt]:
    deepest = max((step.depth for step in steps), default=0.0)
    yield from doubt_rigidity(needle.flexural_rigidity, "flexural_rigidity")
    yield from doubt_depth(deepest, needle.length, "depth")
    yield from doubt_tops(tissue.boundaries.tolist(), deepest, "boundaries")
