"""The two readings of a needle that ends at a boundary: one layer more, or one less.

The paper counts such needles in one way where it lists them and in another where it divides them among its
studies. A study states which reading decides what tunes and what validates; with the same fit and the same
predictions the other one only makes other groups, whose cells stand beside the first.
"""

from dataclasses import replace

from needlefit.datasets.select import get_other_rule
from needlefit.validation.results import Results

Group = tuple[str, int]


def reread(results: Results) -> Results:
    """Return the same results with the insertions grouped by the other reading."""
    record = results.record.model_copy(
        update={"layer_count_rule": get_other_rule(results.record.layer_count_rule)}
    )
    errors = results.errors.assign(
        layers=results.errors["layers_other"], layers_other=results.errors["layers"]
    )
    return replace(results, record=record, errors=errors)


def regrouped(results: Results, role: str) -> set[Group]:
    """Return medium and layers of the groups of a role that the two readings fill differently."""
    rows = results.errors[results.errors["role"] == role]
    doubtful = rows[rows["layers"] != rows["layers_other"]]
    counts = (doubtful["layers"], doubtful["layers_other"])
    return {(str(m), int(n)) for layers in counts for m, n in zip(doubtful["medium"], layers, strict=True)}
