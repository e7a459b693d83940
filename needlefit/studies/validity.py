"""How many simulations of a run were outside what the model assumes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from needlefit.mechanics.shape import LIMITS

VALIDITY_KEY = "validity"  #: key in `run.json`
#: methods whose invalid predictions give a warning; those of a published set are counted only
FITTED_METHODS = ("fitted", "fitted_metric")
MAX_LISTED_ROWS = 20  #: scored simulations outside that are listed; the others are counted
#: share of draws, or of needles predicted by them, that may be outside without a warning: their tails are
MAX_OUTSIDE_SHARE = 0.01
MOSTLY_OUTSIDE = 0.5  #: share of draws outside above which they determine no parameter

_WORDS = {"draws": "draws of the posterior", "predicted": "predictions of held-out insertions"}


@dataclass(frozen=True)
class ValidityCount:
    """A number of simulations, and how many of them are outside the model's assumptions."""

    simulations: int = 0
    outside: int = 0

    def __add__(self, other: "ValidityCount") -> "ValidityCount":
        return ValidityCount(self.simulations + other.simulations, self.outside + other.outside)


@dataclass(frozen=True)
class ValidityCounts:
    """The simulations of one fold, and how many of them are outside the model's assumptions."""

    #: ends of all starts of all searches: one is outside if any of its insertions is
    starts: ValidityCount = ValidityCount()
    #: of the posterior, sampled or by importance about the fit; counted likewise
    draws: ValidityCount = ValidityCount()
    #: needles predicted of held-out insertions, one for each draw
    predicted: ValidityCount = ValidityCount()
    #: fold, role, method, insertion and boundaries of every scored simulation, with `faults` (empty: inside)
    scored: tuple[dict[str, Any], ...] = ()


def tabulate_validity(folds: Sequence[ValidityCounts]) -> dict[str, Any]:
    """Return the counts of all folds as JSON values."""
    scored = [row for one in folds for row in one.scored]
    beyond = [row for row in scored if row["faults"]]
    counts = {
        "scored": ValidityCount(len(scored), len(beyond)),
        "starts": sum((one.starts for one in folds), ValidityCount()),
        "draws": sum((one.draws for one in folds), ValidityCount()),
        "predicted": sum((one.predicted for one in folds), ValidityCount()),
    }
    return {
        **{name: vars(count) for name, count in counts.items()},
        "limits": {name: limit for name, limit, _ in LIMITS},
        "fitted_outside": sum(row["method"] in FITTED_METHODS for row in beyond),
        "scored_outside": beyond[:MAX_LISTED_ROWS],
    }


def list_outside(run: Mapping[str, Any]) -> list[str]:
    """Return in words where fitted, drawn or predicted needles are outside the model's assumptions."""
    table = run.get(VALIDITY_KEY, {})
    fitted = table.get("fitted_outside", 0)
    counts = {name: (table[name]["outside"], table[name]["simulations"]) for name in _WORDS if name in table}
    return [
        *([f"{fitted} scored simulations of the fit"] if fitted else []),
        *(
            f"{outside} of {every} {_WORDS[name]}"
            for name, (outside, every) in counts.items()
            if outside > MAX_OUTSIDE_SHARE * every
        ),
    ]
