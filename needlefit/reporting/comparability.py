"""What makes our row and the paper's comparable, or not, in one plain sentence."""

from needlefit.validation.results import Results

SYNTHETIC = (
    "Synthetic data: agreement with the paper on the twin is consistency, not evidence for the model, "
    "because the twin was built from the paper's own parameters and design."
)


def comparable_validation(results: Results, insertions: int, paper_insertions: int | None) -> str:
    """Return the sentence for a held-out group; `paper_insertions` is None where the paper has no row."""
    if paper_insertions is None:
        return "The paper has no such row."
    return _sentence(results, insertions, paper_insertions, "measured boundaries, mean over insertions")


def comparable_tuning(results: Results, insertions: int, paper_insertions: int | None) -> str:
    """Return the sentence for an in-sample group."""
    if paper_insertions is None:
        return "In-sample; the paper has no such row."
    way = "in-sample, measured boundaries, mean over insertions"
    return _sentence(results, insertions, paper_insertions, way)


def comparable_parameters(results: Results, printed: bool) -> str:
    """Return the sentence for a row of the parameter table; `printed` where the paper has a value."""
    if not printed:
        return "The paper has no such value."
    needles = "on a synthetic twin" if results.origin == "synthetic" else "on other needles"
    return (
        f"Same model, as far as the paper states it: ours fitted {needles}, the paper's tuned by hand on its "
        "own real ones; a parameter has no noise floor."
    )


def _sentence(results: Results, insertions: int, paper_insertions: int, way: str) -> str:
    if (results.errors["comparison"] == "aligned").any():
        return "Not comparable: our errors are after rigid alignment, the paper's in the world frame."
    data = (
        "ours are of a synthetic twin, the paper's of real needles"
        if results.origin == "synthetic"
        else "the needles are not the paper's"
    )
    count = (
        "" if insertions == paper_insertions else f", {_counted(insertions)} here, {paper_insertions} there"
    )
    verdict = (
        "Same metrics and design, other data" if not count else "Same metrics, other data and insertions"
    )
    return f"{verdict}: {way}; {data}{count}; ours are tuned automatically, the paper's by hand."


def _counted(insertions: int) -> str:
    return "1 insertion" if insertions == 1 else f"{insertions} insertions"
