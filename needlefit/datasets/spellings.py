"""Find names that are most likely one in two spellings."""

import re
from collections.abc import Iterable, Iterator
from difflib import SequenceMatcher
from itertools import combinations

#: part of the letters of two names that match, of one that was mistyped: all but one of seven
MIN_ALIKE = 0.85
MIN_LETTERS = 3  #: shorter names are labels


def find_spellings(names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield pairs of names that differ by a letter inside, or by two neighbours that are exchanged.

    Numbers distinguish names, and so do their last letters: pork a and pork b are two.
    """
    for name, other in combinations(dict.fromkeys(names), 2):
        (a, numbers), (b, its_numbers) = _split(name), _split(other)
        if numbers == its_numbers and (a == b or _are_alike(a, b)):
            yield name, other


def _split(name: str) -> tuple[str, list[str]]:
    """Return the letters of a name, and its numbers."""
    return re.sub(r"[\W\d_]", "", name.casefold()), re.findall(r"\d+", name)


def _are_alike(name: str, other: str) -> bool:
    is_label = name[:-1] == other[:-1] or name.startswith(other) or other.startswith(name)
    if is_label or min(len(name), len(other)) < MIN_LETTERS:
        return False
    exchanged = (name[:k] + name[k + 1 : k + 2] + name[k] + name[k + 2 :] for k in range(len(name)))
    return other in exchanged or SequenceMatcher(None, name, other, autojunk=False).ratio() >= MIN_ALIKE
