"""Explain whether our rows and the paper's can be compared, and count layers by the alternative rule.

The two readings of a needle that ends at a boundary: one layer more, or one less.

The paper counts such needles in one way where it lists them and in another where it divides them among its
studies. A study states which reading decides what tunes and what validates; with the same fit and the same
predictions the other one only makes other groups, whose cells stand beside the first.
"""

from dataclasses import replace

from needlefit.datasets.select import get_other_rule
from needlefit.studies.run import Run


def compare_validation_row(results: Run, insertions: int, paper_insertions: int | None) -> str:
    """Return the sentence on comparability of a held-out group; `paper_insertions`: None without a row."""
    if paper_insertions is None:
        return "The paper has no such row."
    return _describe_comparability(
        results, insertions, paper_insertions, "measured boundaries, mean over insertions"
    )


def compare_tuning_row(results: Run, insertions: int, paper_insertions: int | None) -> str:
    """Return the sentence on comparability of an in-sample group."""
    if paper_insertions is None:
        return "In-sample; the paper has no such row."
    conditions = "in-sample, measured boundaries, mean over insertions"
    return _describe_comparability(results, insertions, paper_insertions, conditions)


def compare_parameter_row(results: Run, printed: bool) -> str:
    """Return the sentence on comparability of a parameter; `printed`: the paper has a value."""
    if not printed:
        return "The paper has no such value."
    needles = "to simulated needles" if results.origin == "synthetic" else "to other needles"
    return (
        f"Same model, as far as the paper states it: ours fitted {needles}, the paper's tuned by hand on its "
        "real ones; a parameter has no noise floor."
    )


def _describe_comparability(results: Run, insertions: int, paper_insertions: int, conditions: str) -> str:
    if (results.frames["errors"]["comparison"] == "aligned").any():
        return "Not comparable: our errors are after rigid alignment, the paper's in the world frame."
    data = (
        "ours are of simulated needles, the paper's of real ones"
        if results.origin == "synthetic"
        else "the needles are not the paper's"
    )
    count = (
        ""
        if insertions == paper_insertions
        else f", {_count_insertions(insertions)} here, {paper_insertions} there"
    )
    verdict = (
        "Same metrics and design, other data" if not count else "Same metrics, other data and insertions"
    )
    return f"{verdict}: {conditions}; {data}{count}; ours are tuned automatically, the paper's by hand."


def _count_insertions(insertions: int) -> str:
    return "1 insertion" if insertions == 1 else f"{insertions} insertions"


Group = tuple[str, int]


def use_alternate_count(results: Run) -> Run:
    """Return the same results with the insertions grouped by the alternative rule of counting layers."""
    record = results.record.model_copy(
        update={"layer_count_rule": get_other_rule(results.record.layer_count_rule)}
    )
    errors = results.frames["errors"].assign(
        layers=results.frames["errors"]["layers_other"], layers_other=results.frames["errors"]["layers"]
    )
    return replace(results.with_frames(errors=errors), record=record)


def find_regrouped(results: Run, role: str) -> set[Group]:
    """Return medium and layers of the groups that differ between the two rules of counting layers."""
    rows = results.frames["errors"][results.frames["errors"]["role"] == role]
    doubtful = rows[rows["layers"] != rows["layers_other"]]
    counts = (doubtful["layers"], doubtful["layers_other"])
    return {(str(m), int(n)) for layers in counts for m, n in zip(doubtful["medium"], layers, strict=True)}
