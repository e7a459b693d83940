"""What is found of verification: rows of `needlefit verify`, and what failed in the run itself."""

import math
from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from needlefit.reporting import captions
from needlefit.reporting.credibility.case import Case, drawn, found_in, left_by
from needlefit.reporting.credibility.told import Finding, Told, joined
from needlefit.reporting.tables import Row, records
from needlefit.reporting.verification import bound_said, measured_said
from needlefit.validation.credibility_evidence import EVIDENCE_FIGURES, CredibilityEvidence
from needlefit.validation.results import Results
from needlefit.verification.check import AcceptanceBound, Group

_FILE = "verification.csv"
_CODE = (
    *(Group.CLOSED_FORMS, Group.MANUFACTURED, Group.COLLOCATION),
    *(Group.REFERENCE, Group.SENSITIVITIES, Group.SYMMETRIES),
)


def quality_assurance(case: Case) -> Told:
    """Return with what the run was computed, and that only people can say how that is assured."""
    findings = [
        found_in(one, "run.json", f"Computed with {_listed(versions)}.")
        for one in case.results
        if (versions := one.run.get("versions"))
    ]
    return Told(tuple(findings))


def code_verification(case: Case) -> Told:
    """Return every group of checks of the code, by what is nearest to its bound, and the orders observed."""
    parts = []
    for one in case.counted("verification"):
        orders = drawn(one.folder, EVIDENCE_FIGURES[one.kind], captions.CONVERGENCE)
        pictures = tuple(replace(picture, of_data=False) for picture in orders)
        parts.append(replace(_verified(one, _CODE), pictures=pictures))
    return joined(*parts)


def discretisation(case: Case) -> Told:
    """Return what the mesh leaves, where it was measured with the mesh of the run."""
    parts = []
    for one in case.counted("verification"):
        measured = one.run["rules"]["element"]
        used = {results.run.get("rules", {}).get("element_mm", math.nan) for results in case.results}
        if used == {measured}:
            parts.append(_verified(one, (Group.REFINEMENT,)))
            continue
        sizes = " and ".join(f"{size:g}" for size in sorted(used))
        parts.append(Told(left=(f"Measured at elements of {measured:g} mm; this run’s are {sizes} mm.",)))
    told = joined(*parts)
    if not told.findings:
        return told
    return joined(told, Told(left=("Measured on shipped scenes and random insertions, not on this run’s.",)))


def solver(case: Case) -> Told:
    """Return what the solver's tangent and tolerance leave, and what failed in the run."""
    parts = []
    for one in case.counted("verification"):
        tolerance = measured_said(float(one.run["rules"]["tolerance"]))
        words = f"Newton’s iterations end where the needle moves by no more than {tolerance} mm."
        parts += [
            Told((left_by(one, "run.json", words),)),
            _verified(one, (Group.TANGENT,)),
        ]
    parts += [Told(tuple(_failures(one))) for one in case.results]
    without = () if case.counted("verification") else ("Newton’s tangent: needlefit verify measures it.",)
    return joined(*parts, Told(left=without))


def use_error(case: Case) -> Told:
    """Return what stands in the run so that somebody else can run it again, and which files are damaged."""
    findings = []
    for one in case.results:
        dataset = one.run.get("dataset", {})
        if "sha256" in dataset:
            words = (
                f"Inputs are recorded: dataset {dataset['name']} (sha256 "
                f"{dataset['sha256'][:16]}…), medium, recipe, rules, and which insertions tuned and which "
                "were held out. needlefit diff RUN_A RUN_B says what another run changed."
            )
            findings.append(found_in(one, "run.json", words))
    return Told(tuple(findings), tuple(f"Damaged, and not used: {fault}." for fault in case.damaged))


def _verified(evidence: CredibilityEvidence, groups: Sequence[Group]) -> Told:
    table = evidence.tables[_FILE]
    findings = []
    for group in groups:
        rows = table[table["group"] == group.title]
        if len(rows):
            findings.append(left_by(evidence, _FILE, _group_said(group.title, rows)))
    return Told(tuple(findings))


def _group_said(title: str, rows: pd.DataFrame) -> str:
    """Return how many rows keep their bounds, which do not, and what was measured of every quantity."""
    failing = [f"{row['check']}: {row['quantity']}" for row in records(rows[rows["verdict"] == "FAILS"])]
    kept = int((rows["verdict"] == "passes").sum())
    fails = f"; {len(failing)} FAIL ({'; '.join(failing)})" if failing else ""
    measured = "; ".join(_measured(records(same)) for _, same in rows.groupby("quantity", sort=False))
    said = measured[:1].upper() + measured[1:]
    return f"{title}: {kept} of {len(rows)} rows within their bounds{fails}. {said}."


def _measured(rows: list[Row]) -> str:
    """Return the range of a quantity that has both bounds, of an error that which is nearest to its bound."""
    if rows[0]["bound_low"] is not None:
        values = [_value(row) for row in rows]
        low, high = (measured_said(end) for end in (min(values), max(values)))
        return _beside(rows[0], low if low == high else f"{low} to {high}")
    nearest = max(rows, key=_part_of_bound)
    several = ", nearest to its bound" if len(rows) > 1 else ""
    return _beside(nearest, measured_said(_value(nearest)), several)


def _beside(row: Row, measured: str, several: str = "") -> str:
    unit = f" {row['unit']}" if row["unit"] else ""
    bound = bound_said(AcceptanceBound(row["bound_low"], row["bound_high"]))
    return f"{row['quantity']}{several}: {measured}{unit} (bound {bound})"


def _part_of_bound(row: Row) -> float:
    """Return which part of its bound an error is; of one that is not to be at all, none if it is not."""
    value, bound = _value(row), row["bound_high"]
    if value != value or not bound:
        return 0.0 if value == 0.0 else math.inf
    return float(value / bound)


def _value(row: Row) -> float:
    return math.nan if row["measured"] is None else float(row["measured"])


def _failures(results: Results) -> list[Finding]:
    """Return how many solves of the searches and of the scored needles failed, and faults of searches."""
    begun, fitted = results.starts, results.errors[results.errors["method"] == "fitted"]
    failed, every = int(begun["failed_solves"].sum()), int(begun["evaluations"].sum())
    lost = int((~fitted["converged"].astype(bool)).sum())
    said = [
        ("starts.csv", f"{failed} of {every} evaluations of the searches failed."),
        ("errors.csv", f"{lost} of {len(fitted)} scored simulations of the fit did not converge."),
    ]
    faults = [fault for found in results.run.get("search_faults", {}).values() for fault in found]
    said += [("run.json", f"NOT CONVERGED: {fault}.") for fault in faults]
    return [found_in(results, file, words) for file, words in said]


def _listed(versions: Row) -> str:
    return ", ".join(f"{name} {number}" for name, number in sorted(versions.items()))
