"""Where everything in a bundle comes from: the runs, and the evidence, counted or not and why."""

from collections.abc import Sequence

from needlefit.reporting import document
from needlefit.reporting.credibility.case import Case
from needlefit.reporting.display import Display, text, without_empty
from needlefit.reporting.document import Block
from needlefit.validation.credibility_evidence import CredibilityEvidence
from needlefit.validation.results import Results

SHORT = 16
"""Digits of a sha256 in print; run.json has all."""


def origins(case: Case) -> list[Block]:
    """Return the provenance: tables of runs and of evidence."""
    evidence = evidence_layout(case.evidence)
    looked = (
        [] if evidence.rows else [document.empty("No evidence of other commands was found beside this run.")]
    )
    return [
        document.heading("Provenance"),
        document.text(
            "run.json beside this document has every digest in full; equal files give equal bytes."
        ),
        document.table(_runs(case.results), case.synthetic),
        document.table(evidence, synthetic=False),
        *looked,
    ]


def evidence_layout(evidence: Sequence[CredibilityEvidence]) -> Display:
    """Return one row per folder and run that it was looked at for, and why it is not counted."""
    rows = tuple(
        (one.place, one.command, one.of or "all", "yes" if one.counted else "NO", "; ".join(one.objections))
        for one in evidence
    )
    columns = (
        *(text("Folder"), text("Made by", wide=True), text("For"), text("Counted")),
        text("Why not: unlike the run", wide=True),
    )
    caption = "Evidence of other commands that was looked at."
    return without_empty(Display("evidence", caption, columns, rows))


def _runs(results: Sequence[Results]) -> Display:
    rows = tuple(_run(one) for one in results)
    columns = (
        *(text("Run"), text("Dataset"), text("Origin"), text("sha256"), text("Recipe"), text("Seed")),
        *(text("needlefit"), text("Interrupted")),
    )
    return without_empty(Display("runs", "The runs that this is about.", columns, rows))


def _run(results: Results) -> tuple[str, ...]:
    run = results.run
    dataset, recipe = run.get("dataset", {}), run.get("recipe", {})
    digest = str(dataset.get("sha256", ""))
    return (
        results.name,
        str(dataset.get("name", results.record.dataset)),
        results.origin,
        f"{digest[:SHORT]}…" if digest else "",
        str(recipe.get("title", "")),
        str(recipe.get("seed", "")),
        str(run.get("versions", {}).get("needlefit", "")),
        "YES" if results.interrupted else "",
    )
