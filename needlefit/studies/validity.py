"""How many simulations of a run were outside what the model assumes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from needlefit.mechanics.shape import LIMITS
from needlefit.schemas.run_metadata import CountMetadata, ValidityMetadata

#: methods whose invalid predictions give a warning; those of a published set are counted only
FITTED_METHODS = ("fitted", "fitted_metric")
MAX_LISTED_ROWS = 20  #: scored simulations outside that are listed; the others are counted
#: share of draws, or of needles predicted by them, that may be outside without a warning: their tails are
MAX_OUTSIDE_SHARE = 0.01
MOSTLY_OUTSIDE = 0.5  #: share of draws outside above which they determine no parameter

_PREDICTED = "predictions of held-out insertions"


NO_SIMULATIONS = CountMetadata()


@dataclass(frozen=True)
class ValidityCounts:
    """The simulations of one fold, and how many of them are outside the model's assumptions."""

    #: ends of all starts of all searches: one is outside if any of its insertions is
    starts: CountMetadata = NO_SIMULATIONS
    #: of the posterior, sampled or by importance about the fit; counted likewise
    draws: CountMetadata = NO_SIMULATIONS
    #: needles predicted of held-out insertions, one for each draw
    predicted: CountMetadata = NO_SIMULATIONS
    #: fold, role, method, insertion and boundaries of every scored simulation, with `faults` (empty: inside)
    scored: tuple[dict[str, Any], ...] = ()


def tabulate_validity(folds: Sequence[ValidityCounts]) -> ValidityMetadata:
    """Return the counts of all folds."""
    scored = [row for fold in folds for row in fold.scored]
    beyond = [row for row in scored if row["faults"]]
    return ValidityMetadata(
        scored=CountMetadata(simulations=len(scored), outside=len(beyond)),
        starts=add_counts(fold.starts for fold in folds),
        draws=add_counts(fold.draws for fold in folds),
        predicted=add_counts(fold.predicted for fold in folds),
        limits={name: limit for name, limit, _ in LIMITS},
        fitted_outside=sum(row["method"] in FITTED_METHODS for row in beyond),
        scored_outside=beyond[:MAX_LISTED_ROWS],
    )


def add_counts(counts: Iterable[CountMetadata]) -> CountMetadata:
    """Return the sum of some counts."""
    listed = list(counts)
    return CountMetadata(
        simulations=sum(entry.simulations for entry in listed), outside=sum(entry.outside for entry in listed)
    )


def list_outside(validity: ValidityMetadata) -> list[str]:
    """Return in words where fitted, drawn or predicted needles are outside the model's assumptions."""
    fitted = validity.fitted_outside
    counts = {"draws of the posterior": validity.draws, _PREDICTED: validity.predicted}
    return [
        *([f"{fitted} scored simulations of the fit"] if fitted else []),
        *(
            f"{count.outside} of {count.simulations} {words}"
            for words, count in counts.items()
            if count.outside > MAX_OUTSIDE_SHARE * count.simulations
        ),
    ]
