"""What counts as one observation when a scatter between needles is taken."""

from collections.abc import Sequence

ENOUGH = 5
"""Fewest groups from which a scatter between them is taken."""


def groups(insertions: Sequence[str], specimens: Sequence[str]) -> tuple[str, ...]:
    """Return the group of each insertion: its specimen where there are enough of these, else itself.

    Repeats in one specimen (one hole at several depths) are no independent observations; but where
    everything went into a few pieces, the insertions are all there is.
    """
    return tuple(specimens) if len(set(specimens)) >= ENOUGH else tuple(insertions)
