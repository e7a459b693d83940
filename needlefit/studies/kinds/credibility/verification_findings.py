"""Findings on verification: rows of `needlefit verify`, and failures in the run itself."""

import math
from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from needlefit.reporting import labels
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.kinds.credibility.case import (
    CredibilityCase,
    FactorFindings,
    Finding,
    find_figure,
    join_findings,
    make_evidence_finding,
    make_finding,
)
from needlefit.studies.kinds.credibility.evidence import EVIDENCE_FIGURES, CredibilityEvidence
from needlefit.studies.kinds.verification.report import format_bound, format_measured
from needlefit.studies.run import Run
from needlefit.verification.check import AcceptanceBound, Group

_VERIFICATION_FILE = "verification.csv"
_CODE_GROUPS = (
    *(Group.CLOSED_FORMS, Group.MANUFACTURED, Group.COLLOCATION),
    *(Group.REFERENCE, Group.SENSITIVITIES, Group.SYMMETRIES),
)


def find_quality_assurance(case: CredibilityCase) -> FactorFindings:
    """Return the software that computed the run; its quality assurance can be stated only by people."""
    findings = [
        make_finding(one, "run.json", f"Computed with {_join_versions(versions)}.")
        for one in case.results
        if (versions := one.run.get("versions"))
    ]
    return FactorFindings(tuple(findings))


def find_code_verification(case: CredibilityCase) -> FactorFindings:
    """Return every group of code checks with the check nearest to its bound, and the observed orders."""
    parts = []
    for one in case.counted("verification"):
        orders = find_figure(one.folder, EVIDENCE_FIGURES[one.kind], labels.CONVERGENCE_CAPTION)
        pictures = tuple(replace(picture, shows_run_data=False) for picture in orders)
        parts.append(replace(_find_verification(one, _CODE_GROUPS), pictures=pictures))
    return join_findings(*parts)


def find_discretisation(case: CredibilityCase) -> FactorFindings:
    """Return the discretisation error, if it was measured with the mesh of the run."""
    parts = []
    for one in case.counted("verification"):
        measured = one.run["rules"]["element"]
        used = {results.run.get("rules", {}).get("element_mm", math.nan) for results in case.results}
        if used == {measured}:
            parts.append(_find_verification(one, (Group.REFINEMENT,)))
            continue
        sizes = " and ".join(f"{size:g}" for size in sorted(used))
        parts.append(
            FactorFindings(gaps=(f"Measured at elements of {measured:g} mm; this run’s are {sizes} mm.",))
        )
    content = join_findings(*parts)
    if not content.findings:
        return content
    return join_findings(
        content,
        FactorFindings(gaps=("Measured on shipped scenes and random insertions, not on this run’s.",)),
    )


def find_solver(case: CredibilityCase) -> FactorFindings:
    """Return the errors of the solver's tangent and tolerance, and the failures of the run."""
    parts = []
    for one in case.counted("verification"):
        tolerance = format_measured(float(one.run["rules"]["tolerance"]))
        words = f"Newton’s iterations end where the needle moves by no more than {tolerance} mm."
        parts += [
            FactorFindings((make_evidence_finding(one, "run.json", words),)),
            _find_verification(one, (Group.TANGENT,)),
        ]
    parts += [FactorFindings(tuple(_find_failures(one))) for one in case.results]
    without = () if case.counted("verification") else ("Newton’s tangent: needlefit verify measures it.",)
    return join_findings(*parts, FactorFindings(gaps=without))


def find_use_error(case: CredibilityCase) -> FactorFindings:
    """Return what the run stores for a repetition by others, and which of its files are damaged."""
    findings = []
    for one in case.results:
        dataset = one.run.get("dataset", {})
        if "sha256" in dataset:
            words = (
                f"Inputs are recorded: dataset {dataset['name']} (sha256 "
                f"{dataset['sha256'][:16]}…), medium, recipe, rules, and which insertions tuned and which "
                "were held out. needlefit diff RUN_A RUN_B lists what another run changed."
            )
            findings.append(make_finding(one, "run.json", words))
    return FactorFindings(
        tuple(findings), tuple(f"Damaged, and not used: {fault}." for fault in case.damaged)
    )


def _find_verification(evidence: CredibilityEvidence, groups: Sequence[Group]) -> FactorFindings:
    table = evidence.tables[_VERIFICATION_FILE]
    findings = []
    for group in groups:
        rows = table[table["group"] == group.title]
        if len(rows):
            findings.append(
                make_evidence_finding(evidence, _VERIFICATION_FILE, _describe_group(group.title, rows))
            )
    return FactorFindings(tuple(findings))


def _describe_group(title: str, rows: pd.DataFrame) -> str:
    """Return how many rows keep their bounds, which do not, and what was measured of every quantity."""
    failing = [f"{row['check']}: {row['quantity']}" for row in to_records(rows[rows["verdict"] == "FAILS"])]
    kept = int((rows["verdict"] == "passes").sum())
    fails = f"; {len(failing)} FAIL ({'; '.join(failing)})" if failing else ""
    measured = "; ".join(
        _describe_measured(to_records(same)) for _, same in rows.groupby("quantity", sort=False)
    )
    summary = measured[:1].upper() + measured[1:]
    return f"{title}: {kept} of {len(rows)} rows within their bounds{fails}. {summary}."


def _describe_measured(rows: list[Row]) -> str:
    """Return the range of a quantity that has both bounds, of an error that which is nearest to its bound."""
    if rows[0]["bound_low"] is not None:
        values = [_measured_value(row) for row in rows]
        low, high = (format_measured(end) for end in (min(values), max(values)))
        return _format_beside_bound(rows[0], low if low == high else f"{low} to {high}")
    nearest = max(rows, key=_fraction_of_bound)
    several = ", nearest to its bound" if len(rows) > 1 else ""
    return _format_beside_bound(nearest, format_measured(_measured_value(nearest)), several)


def _format_beside_bound(row: Row, measured: str, several: str = "") -> str:
    unit = f" {row['unit']}" if row["unit"] else ""
    bound = format_bound(AcceptanceBound(row["bound_low"], row["bound_high"]))
    return f"{row['quantity']}{several}: {measured}{unit} (bound {bound})"


def _fraction_of_bound(row: Row) -> float:
    """Return which part of its bound an error is; of one that is not to be at all, none if it is not."""
    value, bound = _measured_value(row), row["bound_high"]
    if value != value or not bound:
        return 0.0 if value == 0.0 else math.inf
    return float(value / bound)


def _measured_value(row: Row) -> float:
    return math.nan if row["measured"] is None else float(row["measured"])


def _find_failures(results: Run) -> list[Finding]:
    """Return how many solves of the searches and of the scored needles failed, and faults of searches."""
    begun, fitted = (
        results.frames["starts"],
        results.frames["errors"][results.frames["errors"]["method"] == "fitted"],
    )
    failed, every = int(begun["failed_solves"].sum()), int(begun["evaluations"].sum())
    lost = int((~fitted["converged"].astype(bool)).sum())
    summary = [
        ("starts.csv", f"{failed} of {every} evaluations of the searches failed."),
        ("errors.csv", f"{lost} of {len(fitted)} scored simulations of the fit did not converge."),
    ]
    faults = [fault for found in results.run.get("search_faults", {}).values() for fault in found]
    summary += [("run.json", f"NOT CONVERGED: {fault}.") for fault in faults]
    return [make_finding(results, file, words) for file, words in summary]


def _join_versions(versions: Row) -> str:
    return ", ".join(f"{name} {number}" for name, number in sorted(versions.items()))
