"""How many simulations of a run were outside what the model assumes."""

from collections.abc import Iterable, Mapping, Sequence

from needlefit.mechanics.shape import LIMITS
from needlefit.reporting.table_files import Row
from needlefit.schemas.run_metadata import CountMetadata, ValidityMetadata

#: methods whose invalid predictions give a warning
FITTED_METHODS = ("fitted", "fitted_metric")
#: share of draws, or of needles predicted by them, that may be outside without a warning: their tails are
MAX_OUTSIDE_SHARE = 0.01
MOSTLY_OUTSIDE = 0.5  #: share of draws outside above which they determine no parameter

_PREDICTED = "predictions of held-out insertions"


def tabulate_validity(
    folds: Sequence[Mapping[str, CountMetadata]], outside: Sequence[Row]
) -> ValidityMetadata:
    """Return the counts of all folds.

    folds
        By kind the simulations of each: "draws" of the posterior, of which one is outside if any of its
        insertions is; "predicted", needles of held-out insertions, one for each draw.
    outside
        Each scored simulation that is outside, by its method.
    """
    return ValidityMetadata(
        **{kind: add_counts(counts[kind] for counts in folds) for kind in ("draws", "predicted")},
        limits={name: limit for name, limit, _ in LIMITS},
        fitted_outside=sum(row["method"] in FITTED_METHODS for row in outside),
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
