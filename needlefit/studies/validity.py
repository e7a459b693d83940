"""How many simulations of a run were outside what the model assumes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from needlefit.mechanics.shape import LIMITS, Validity

VALIDITY_KEY = "validity"  #: key in `run.json`
#: methods whose invalid predictions give a warning; those of a published set are counted only
FITTED_METHODS = ("fitted", "fitted_metric")
MAX_LISTED_ROWS = 20  #: scored simulations outside that are listed; the others are counted
#: share of draws, or of needles predicted by them, that may be outside without a warning: their tails are
MAX_OUTSIDE_SHARE = 0.01
MOSTLY_OUTSIDE = 0.5  #: share of draws outside above which they determine no parameter

_WORDS = {"draws": "draws of the posterior", "predicted": "predictions of held-out insertions"}


@dataclass
class ValidityCount:
    """A number of simulations, and how many of them are outside the model's assumptions."""

    simulations: int = 0
    outside: int = 0

    def add(self, simulations: int, outside: int) -> None:
        self.simulations += simulations
        self.outside += outside


@dataclass
class ValidityCounts:
    """The simulations of one run, and how many of them are outside the model's assumptions."""

    #: ends of all starts of all searches: one is outside if any of its insertions is
    starts: ValidityCount = field(default_factory=ValidityCount)
    #: of the posterior, sampled or by importance about the fit; counted likewise
    draws: ValidityCount = field(default_factory=ValidityCount)
    #: needles predicted of held-out insertions, one for each draw
    predicted: ValidityCount = field(default_factory=ValidityCount)
    #: fold, role, method, insertion and boundaries of every scored simulation, with `faults` (empty: inside)
    scored: list[dict[str, Any]] = field(default_factory=list)

    def score(self, place: Mapping[str, Any], validity: Validity) -> None:
        self.scored.append({**place, "faults": list(validity.faults)})

    def table(self) -> dict[str, Any]:
        """Return the counts as JSON values."""
        beyond = [row for row in self.scored if row["faults"]]
        counts = {"scored": ValidityCount(len(self.scored), len(beyond))}
        counts |= {name: getattr(self, name) for name in ("starts", "draws", "predicted")}
        table: dict[str, Any] = {name: vars(count) for name, count in counts.items()}
        table["limits"] = {name: limit for name, limit, _ in LIMITS}
        table["fitted_outside"] = sum(row["method"] in FITTED_METHODS for row in beyond)
        table["scored_outside"] = beyond[:MAX_LISTED_ROWS]
        return table


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
