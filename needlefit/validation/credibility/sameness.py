"""Is evidence of the same thing as a run: same versions, data, model, recipe and insertions?

What is not, is not counted, whatever it says; what does not state itself is not taken for the same.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from needlefit.validation.differences import leaves

Table = Mapping[str, Any]

_WORDS = ("title", "note", "seed")
"""Last parts of keys that change no meaning: another seed is another try at the same."""

_SHOWN = 3
"""Differences named one by one."""


def identity(work: Table, dataset: Table | None = None) -> dict[str, Any]:
    """Return what makes the work of a run what it is; None for what it does not state.

    `dataset` is given where `run.json` keeps it elsewhere.
    """
    data = work.get("dataset") if dataset is None else dataset
    folds = work.get("folds") or ()
    return {
        "dataset": {key: data.get(key) for key in ("name", "sha256", "needle")} if data else None,
        "medium": work.get("medium"),
        "recipe": work.get("recipe"),
        "rules": work.get("rules"),
        "tuned on": [fold["tune"] for fold in folds] or None,
    }


def of_versions(there: Table, here: Table) -> list[str]:
    """Return in what versions two runs differ, of those that both name."""
    one, two = there.get("versions"), here.get("versions")
    if not one or not two:
        return ["versions are not stated " + ("here" if one else "there")]
    return [
        _said(f"version of {key}", one[key], two[key]) for key in one if one[key] != two.get(key, one[key])
    ]


def unlike(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Return in what two identities differ, in words, the first few named one by one."""
    found = list(_unlike(there, here))
    more = len(found) - _SHOWN
    return found if more <= 0 else [*found[:_SHOWN], f"and {more} more"]


def _unlike(there: Mapping[str, Any], here: Mapping[str, Any]) -> Iterator[str]:
    for part, two in here.items():
        one = there.get(part)
        if one is None or two is None:
            yield f"{part}: not stated {'there' if one is None else 'here'}"
            continue
        first, second = dict(leaves(one)), dict(leaves(two))
        for key in dict.fromkeys([*first, *second]):
            if first.get(key) != second.get(key) and key.rpartition(".")[2] not in _WORDS:
                yield _said(f"{part} {key}".strip(), first.get(key), second.get(key))


def _said(what: str, there: object, here: object) -> str:
    return f"{what}: {_short(there)} there, {_short(here)} here"


def _short(value: object) -> str:
    words = "nothing" if value is None else str(value)
    return words if len(words) <= 16 else f"{words[:12]}…"
