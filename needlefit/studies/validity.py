"""How many simulations of a run were outside what the model assumes."""

from collections.abc import Iterable, Mapping, Sequence

from needlefit.mechanics.shape import LIMITS
from needlefit.reporting.table_files import Row
from needlefit.schemas.run_metadata import CountMetadata, ValidityMetadata

#: methods whose invalid predictions give a warning; those of a published set are counted only
FITTED_METHODS = ("fitted", "fitted_metric")
MAX_LISTED_ROWS = 20  #: scored simulations outside that are listed; the others are counted
#: share of draws, or of needles predicted by them, that may be outside without a warning: their tails are
MAX_OUTSIDE_SHARE = 0.01
MOSTLY_OUTSIDE = 0.5  #: share of draws outside above which they determine no parameter

_PREDICTED = "predictions of held-out insertions"


def tabulate_validity(
    folds: Sequence[Mapping[str, CountMetadata]], scored: Sequence[Row]
) -> ValidityMetadata:
    """Return the counts of all folds.

    folds
        By kind the simulations of each: "starts", the ends of all starts of all searches, of which one is
        outside if any of its insertions is; "draws" of the posterior, counted likewise; "predicted", needles
        of held-out insertions, one for each draw.
    scored
        Fold, role, method, insertion and boundaries of every scored simulation, with its `faults`.
    """
    beyond = [row for row in scored if row["faults"]]
    return ValidityMetadata(
        scored=CountMetadata(simulations=len(scored), outside=len(beyond)),
        **{kind: add_counts(counts[kind] for counts in folds) for kind in ("starts", "draws", "predicted")},
        limits={name: limit for name, limit, _ in LIMITS},
        fitted_outside=sum(row["method"] in FITTED_METHODS for row in beyond),
        scored_outside=beyond[:MAX_LISTED_ROWS],
    )


def add_counts(counts: Iterable[CountMetadata]) -> CountMetadata:
    """Return the sum of some counts."""
    pairs = [(count.simulations, count.outside) for count in counts]
    simulations, outside = (sum(numbers) for numbers in zip((0, 0), *pairs, strict=True))
    return CountMetadata(simulations=simulations, outside=outside)


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
