"""What `validate` prints for people: our row and the paper's, one below the other."""

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from needlefit.cli import screen

if TYPE_CHECKING:
    from needlefit.validation.results import Results

_LABELS = {
    "median_err_mm": "median mm",
    "ipe_mean_mm": "IPE mm",
    "ipe_std_mm": "std mm",
    "ipe_max_mm": "max mm",
    "te_mm": "TE mm",
    "edp_percent": "EDP %",
}


def show_validation(results: "Results") -> None:
    """Print the validation table of one study, then the rivals on the same points."""
    from needlefit.reporting.tables import validation_table
    from needlefit.validation.summary import beaten_by, paired

    screen.say(f"{results.name}: {results.title}")
    screen.say(f"  {origin(results)}")
    rows = [row for ours in validation_table(results).to_dict("records") for row in _pair(ours)]
    screen.show_table(["validated on", "layers", "whose", *_LABELS.values()], rows)
    table = paired(results)
    columns = ["rival", "IPE mm", "TE mm", "IPE minus the fit's, mm", "s.e.", "fit better on", "of"]
    keys = ["rival", "ipe_mean_mm", "te_mm", "difference_mm", "difference_se_mm", "better", "insertions"]
    screen.show_table(columns, table[keys].itertuples(index=False), "On the same insertions and points")
    winners = beaten_by(results)
    if winners:
        screen.say(f"An empirical curve does better here than the model: {', '.join(winners)}.")


def origin(results: "Results") -> str:
    """Return what the data are, in words that a reader cannot miss."""
    if results.origin == "synthetic":
        return (
            f"SYNTHETIC data ({results.dataset_title}): consistency of the program, no evidence for the model"
        )
    return f"measured data: {results.dataset_title}"


def _pair(row: Mapping[Any, Any]) -> Iterator[list[object]]:
    """Yield our cells, their noise floor, and the paper's where it prints any."""
    about = [row["validate_medium"], row["validate_layers"]]
    yield [*about, "needlefit", *(row[key] for key in _LABELS)]
    floor = [row.get(f"floor_{key}", math.nan) for key in _LABELS]
    if not all(_missing(value) for value in floor):
        yield ["", "", "noise floor", *floor]
    paper = [row.get(f"paper_{key}", math.nan) for key in _LABELS]
    if not all(_missing(value) for value in paper):
        yield ["", "", "paper", *paper]


def _missing(value: object) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))
