"""What a sensitivity study found of everything that was decided or is not known well."""

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from needlefit.reporting.credibility.case import Case, left_by
from needlefit.reporting.credibility.told import Told, joined
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.numbers import fixed
from needlefit.reporting.tables import records
from needlefit.validation.credibility_evidence import CredibilityEvidence

_CELLS, _STUDIES = "cells.csv", "studies.csv"
_METRICS = ("ipe_mean_mm", "te_mm")
_TUNED = {"again": "tuned again", "kept": "kept"}


def varied(case: Case, subjects: Sequence[str]) -> Told:
    """Return what varying each subject did to the errors of these runs; each one that was not, as a gap."""
    every = case.counted("sensitivity")
    studies = {one.place: one for one in every}
    parts = [_told(case, one, subjects) for one in studies.values()]
    known = {name for one in studies.values() for name in _rows(case, one, _CELLS)["aspect"]}
    lacking = [name for name in subjects if name not in known]
    said = (f"What these matter: nothing found of {', '.join(lacking)}. {_MEND}",) if lacking else ()
    return joined(*parts, Told(left=said))


_MEND = "needlefit validate sensitivity would tell."


def _told(case: Case, evidence: CredibilityEvidence, subjects: Sequence[str]) -> Told:
    cells, studies = (_rows(case, evidence, file) for file in (_CELLS, _STUDIES))
    cells = cells[cells["aspect"].isin(subjects) & cells["metric"].isin(_METRICS)]
    if cells.empty:
        return Told()
    words = [_said(str(name), group) for name, group in cells.groupby("aspect", sort=False)]
    findings = [left_by(evidence, _CELLS, one) for one in words]
    concluded = studies[studies["aspect"].isin(subjects) & (studies["tuned"] == "again")]
    if len(concluded):
        findings.append(left_by(evidence, _STUDIES, _conclusion_said(concluded)))
    faults = tuple(f"NOT TO BE TRUSTED: {evidence.place}: {why}." for why in evidence.run.get("faults", ()))
    # it is of all the runs that it counts for
    return Told(tuple(replace(one, of="") for one in findings), faults, (_layout(cells),))


def _said(name: str, rows: pd.DataFrame) -> str:
    """Return the largest changes under all variations of one subject, parameters tuned again."""
    again = rows[rows["tuned"] == "again"]
    count = again["variation"].nunique()
    ipe, te = (
        f"{fixed(_largest(again, metric, 'change'), 3)} mm "
        f"({fixed(_largest(again, metric, 'change_in_floors'), 1)} noise floors)"
        for metric in _METRICS
    )
    ways = "1 variation" if count == 1 else f"{count} variations"
    head = f"{name[:1].upper()}{name[1:]}, {ways}, tuned again"
    return f"{head}: mean IPE of a cell changes by at most {ipe}, TE by at most {te}."


def _conclusion_said(rows: pd.DataFrame) -> str:
    """Return whether who generalises changes under any of these variations, everything tuned again."""
    changed = records(rows[rows["conclusion_changes"].astype(bool)])
    limit = f"{rows['threshold_mm'].iloc[0]:.2f}"
    if not changed:
        return f"Which studies generalise (mean IPE below {limit} mm) is the same under all these variations."
    which = "; ".join(f"{row['study']} under {row['aspect']}: {row['variation']}" for row in changed)
    return f"Which studies generalise (mean IPE below {limit} mm) CHANGES for {which}."


def _layout(rows: pd.DataFrame) -> Display:
    """Return one row per variation: how far the cells of these runs moved, in either direction."""
    cells, breaks, last = list[tuple[str, ...]](), list[int](), ""
    for (of, variation, tuned), group in rows.groupby(["aspect", "variation", "tuned"], sort=False):
        if of != last and cells:
            breaks.append(len(cells))
        count = len(group[["table", "study", "medium", "layers"]].drop_duplicates())
        numbers = [
            fixed(_largest(group, metric, column), digits)
            for metric in _METRICS
            for column, digits in (("change", 3), ("change_in_floors", 1))
        ]
        head = str(of) if of != last else ""
        cells.append((head, str(variation), _TUNED.get(str(tuned), str(tuned)), str(count), *numbers))
        last = str(of)
    columns = (
        *(text("Of"), text("Variation", wide=True), text("Parameters"), Column("Cells")),
        *(Column("IPE", "mm"), Column("÷ floor"), Column("TE", "mm"), Column("÷ floor")),
    )
    caption = "Largest change of any cell of these runs’ tables under each variation."
    return Display("sensitivity", caption, columns, tuple(cells), tuple(breaks))


def _largest(rows: pd.DataFrame, metric: str, column: str) -> float:
    return float(rows.loc[rows["metric"] == metric, column].abs().max())


def _rows(case: Case, evidence: CredibilityEvidence, file: str) -> pd.DataFrame:
    """Return what a table has of the runs that it counts for, but as it was decided."""
    table = evidence.tables[file]
    counted = [one.of for one in case.counted("sensitivity") if one.place == evidence.place]
    return table[table["study"].isin(counted) & (table["aspect"] != "as decided")]
