"""Divide points by their labels, as `N1-1`, `N1-2`, `N2-1`: the name of a needle, and a number."""

import re
from collections import Counter
from collections.abc import Sequence
from itertools import groupby

from needlefit.datasets.points import MIN_POINTS
from needlefit.grouping import group_values

_LABEL = re.compile(r"(.*?)[\s_.:/#-]*(\d{1,6})")
_NUMBER = re.compile(r"\d+\.\d+")


def divide_labels(labels: Sequence[str]) -> dict[str, list[int]]:
    """Return the points of each needle by its name; nothing where labels do not name needles.

    They do where each point has its own, all are a name and a number, and each name has enough points for a
    curve; or fewer that follow each other, and the numbers begin again: programs number all points of a list
    after one name.
    """
    matches = [match for label in labels if (match := _LABEL.fullmatch(label.strip()))]
    parts = [(match[1], int(match[2])) for match in matches]
    groups = group_values((name, row) for row, (name, _) in enumerate(parts))
    is_named = len(parts) == len({*parts}) == len(labels) and 1 < len(groups) < len(labels)
    if not is_named or min(map(len, groups.values())) >= MIN_POINTS:
        return groups if is_named else {}
    runs = sum(1 for _ in groupby(name for name, _ in parts))
    names = Counter(number for _, number in parts)  # that have a number
    begins_again = all(max(names[parts[row][1]] for row in rows) > 1 for rows in groups.values())
    is_decimal = any(_NUMBER.fullmatch(label.strip()) for label in labels)  # `10.5` is a number
    return groups if runs == len(groups) and begins_again and not is_decimal else {}
