"""Findings on the computational model: form, and sensitivity to and uncertainty of inputs."""

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from needlefit.metrics import headline_metrics
from needlefit.reporting import labels
from needlefit.reporting.number_format import format_mm, insert_symbols
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.identification_tables import describe_verdicts
from needlefit.studies.kinds.credibility.case import (
    CredibilityCase,
    FactorFindings,
    find_figure,
    find_target,
    join_findings,
    make_evidence_finding,
    make_finding,
)
from needlefit.studies.kinds.credibility.evidence import EVIDENCE_FIGURES, CredibilityEvidence
from needlefit.studies.rank_statistics import CONTROL_NAMES, name_quantity
from needlefit.studies.report import say
from needlefit.studies.run import Run

_CELLS_FILE, _STUDIES_FILE = "cells.csv", "studies.csv"
_TUNING_NAMES = {"again": "tuned again", "kept": "kept"}


def find_variations(case: CredibilityCase, aspects: Sequence[str]) -> FactorFindings:
    """Return how much varying each input or rule changes the errors; one that was not varied is a gap."""
    every = case.counted("sensitivity")
    studies = {one.place: one for one in every}
    parts = [_find_variations_of(case, one, aspects) for one in studies.values()]
    known = {name for one in studies.values() for name in _select_rows(case, one, _CELLS_FILE)["aspect"]}
    lacking = [name for name in aspects if name not in known]
    summary = (
        (f"What these matter: nothing found of {', '.join(lacking)}. {_FIX_SENSITIVITY}",) if lacking else ()
    )
    return join_findings(*parts, FactorFindings(gaps=summary))


_FIX_SENSITIVITY = "`needlefit validate sensitivity` would show it."


def _find_variations_of(
    case: CredibilityCase, evidence: CredibilityEvidence, aspects: Sequence[str]
) -> FactorFindings:
    cells, studies = (_select_rows(case, evidence, file) for file in (_CELLS_FILE, _STUDIES_FILE))
    metrics = [metric.name for metric in headline_metrics()]
    cells = cells[cells["aspect"].isin(aspects) & cells["metric"].isin(metrics)]
    if cells.empty:
        return FactorFindings()
    words = [
        _describe_largest_change(str(name), group) for name, group in cells.groupby("aspect", sort=False)
    ]
    findings = [make_evidence_finding(evidence, _CELLS_FILE, one) for one in words]
    concluded = studies[studies["aspect"].isin(aspects) & (studies["tuned"] == "again")]
    if len(concluded):
        findings.append(make_evidence_finding(evidence, _STUDIES_FILE, _describe_conclusions(concluded)))
    faults = tuple(f"NOT TO BE TRUSTED: {evidence.place}: {why}." for why in evidence.run.get("faults", ()))
    # it is of all the runs that it counts for
    return FactorFindings(
        tuple(replace(one, target="") for one in findings), faults, (_lay_out_variations(cells),)
    )


def _describe_largest_change(name: str, rows: pd.DataFrame) -> str:
    """Return the largest changes under all variations of one subject, parameters tuned again."""
    again = rows[rows["tuned"] == "again"]
    count = again["variation"].nunique()
    sizes = []
    for metric in headline_metrics():
        change = _largest_change(again, metric.name, "change")
        floors = _largest_change(again, metric.name, "change_in_floors")
        size = f"{format_mm(change, 3)} {metric.unit} ({format_mm(floors, 1)} noise floors)"
        sizes.append(f"{metric.label} by at most {size}")
    count_words = "1 variation" if count == 1 else f"{count} variations"
    head = f"{name[:1].upper()}{name[1:]}, {count_words}, tuned again"
    return f"{head}: cells change: {', '.join(sizes)}."


def _describe_conclusions(rows: pd.DataFrame) -> str:
    """Return whether who generalises changes under any of these variations, everything tuned again."""
    once = rows.drop_duplicates(["aspect", "variation", "study"])  # it has a row per metric
    changed = to_records(once[once["conclusion_changes"].astype(bool)])
    limit = f"{rows['limit_mm'].iloc[0]:.2f}"
    if not changed:
        return f"Which studies generalise (mean IPE below {limit} mm) is the same under all these variations."
    which = "; ".join(f"{row['study']} under {row['aspect']}: {row['variation']}" for row in changed)
    return f"Which studies generalise (mean IPE below {limit} mm) CHANGES for {which}."


def _lay_out_variations(rows: pd.DataFrame) -> TableLayout:
    """Return one row per variation: how far the cells of these runs moved, in either direction."""
    metrics = [metric.name for metric in headline_metrics()]
    changes = [
        {
            **dict(zip(("aspect", "variation", "tuned"), key, strict=True)),
            "tuned": _TUNING_NAMES.get(str(key[2]), str(key[2])),
            "cells": len(group[["grouping", "study", "medium", "layers"]].drop_duplicates()),
            "metric": name,
            "change_size": _largest_change(group, name, "change"),
            "over_floor": _largest_change(group, name, "change_in_floors"),
        }
        for key, group in rows.groupby(["aspect", "variation", "tuned"], sort=False)
        for name in metrics
    ]
    columns = (
        *("aspect", "variation", "tuned", "cells"),
        *(part(key, metric=name) for name in metrics for key in ("change_size", "over_floor")),
    )
    caption = "Largest change of any cell of these runs’ tables under each variation."
    varied = pivot(changes, ["aspect", "variation", "tuned"], ["metric"])
    return Table("sensitivity", caption, varied, columns, groups=("aspect",), heads=1).lay_out()


def _largest_change(rows: pd.DataFrame, metric: str, column: str) -> float:
    return float(rows.loc[rows["metric"] == metric, column].abs().max())


def _select_rows(case: CredibilityCase, evidence: CredibilityEvidence, file: str) -> pd.DataFrame:
    """Return what a table has of the runs that it counts for, but as it was decided."""
    table = evidence.tables[file]
    counted = [one.target for one in case.counted("sensitivity") if one.place == evidence.place]
    return table[table["study"].isin(counted) & (table["aspect"] != "as decided")]


FORM_ASPECTS = ("tie", "advance", "constraint spacing", "first cell", "phase of the grid")
"""Rules of the model, by the names of their variations in a sensitivity study."""

INPUT_ASPECTS = ("thickness", "rigidity", "layer depths")
"""Inputs of the model, by the names of their variations in a sensitivity study."""


def find_form(case: CredibilityCase) -> FactorFindings:
    """Return findings on model form: the decided rules, curves without mechanics, rules that matter."""
    findings = []
    for one in case.results:
        if rules := one.run.get("rules"):
            summary = "; ".join(_format_rule(key, value) for key, value in sorted(rules.items()))
            findings.append(make_finding(one, "run.json", f"Rules: {summary}."))
        findings.append(make_finding(one, "errors.csv", say(one, "conclusion", "ties", "paper_sets")))
    law = "Another tissue law in place of this one: not examined here; a comparison study shows it."
    return join_findings(
        FactorFindings(tuple(findings)), find_variations(case, FORM_ASPECTS), FactorFindings(gaps=(law,))
    )


def find_sensitivities(case: CredibilityCase) -> FactorFindings:
    """Return findings on sensitivity: the parameters that the data determine, and the inputs that matter."""
    known = [make_finding(one, "parameters.csv", say(one, "undetermined")) for one in case.results]
    known += [
        make_evidence_finding(one, "identify.csv", insert_symbols(" ".join(summary)))
        for one in case.counted("identification")
        if (summary := _describe_identification(one))
    ]
    missing = [one for one in _list_lacking(case, "identification") if one not in _list_examined(case)]
    gaps = (
        (f"Profile likelihoods of {', '.join(missing)}: nothing found. {_FIX_IDENTIFY}",) if missing else ()
    )
    return join_findings(FactorFindings(tuple(known), gaps), find_variations(case, INPUT_ASPECTS))


def find_uncertainties(case: CredibilityCase) -> FactorFindings:
    """Return findings on uncertainty: of parameters and predictions, and whether they are calibrated."""
    parts = [_find_combinations(case, one) for one in case.results]
    parts += [_find_predictions(case, one) for one in case.held_out]
    parts += [_find_calibration(case, one) for one in case.counted("calibration")]
    missing = _list_lacking(case, "calibration")
    summary = (
        f"Whether these uncertainties are right, of {', '.join(missing)}: nothing found. {_FIX_CALIBRATE}"
    )
    return join_findings(*parts, FactorFindings(gaps=(summary,) if missing else ()))


_FIX_IDENTIFY = "needlefit identify TARGET would give them."
_FIX_CALIBRATE = "`needlefit calibrate TARGET` would show it."


def _format_rule(key: str, value: object) -> str:
    """Return "constraint spacing 1 mm", "tie: nearest constraint ..."."""
    name = key.removesuffix("_mm").replace("_", " ")
    if isinstance(value, float):
        return f"{name} {value:g}" + (" mm" if key.endswith("_mm") else "")
    return f"{name}: {value}"


def _find_combinations(case: CredibilityCase, results: Run) -> FactorFindings:
    """Return the best-known and the worst-known combination of parameters."""
    rows = results.frames["directions"]
    if rows.empty:
        return FactorFindings()
    ordered = rows.sort_values("sd", kind="stable")
    ends = dict.fromkeys(insert_symbols(str(ordered["note"].iloc[k])) for k in (0, -1))
    sds = [f"{ordered['sd'].iloc[k]:.2g}" for k in (0, -1)][: len(ends)]
    summary = "; ".join(f"{words} (sd {sd})" for words, sd in zip(ends, sds, strict=True))
    return FactorFindings((make_finding(results, "directions.csv", f"Best and worst known: {summary}."),))


def _find_predictions(case: CredibilityCase, results: Run) -> FactorFindings:
    """Return how wide the bands of held-out needles are; without any, that nothing was propagated."""
    rows = results.frames["predictive"]
    if rows.empty:
        words = f"{case.gap_prefix(results)}no uncertainty was propagated to held-out needles: nothing found."
        return FactorFindings(gaps=(words[:1].upper() + words[1:],))
    width = (rows["tip_95_high_mm"] - rows["tip_95_low_mm"]).astype(float)
    words = (
        f"Parameters, depths and measurement errors are propagated to {len(rows)} held-out needles: the 95 % "
        f"interval of the tip is {format_mm(width.min())} to {format_mm(width.max())} mm wide."
    )
    found = [make_finding(results, "predictive.csv", words)]
    doubtful = int((~rows["certified"].astype(bool)).sum())
    gaps = (f"{case.gap_prefix(results)}The draws behind {doubtful} of these needles are NOT CERTIFIED.",)
    return FactorFindings(tuple(found), gaps if doubtful else ())


def _find_calibration(case: CredibilityCase, one: CredibilityEvidence) -> FactorFindings:
    """Return what simulation-based calibration came to: by drawn truths, or wrong on purpose."""
    if one.run.get("control"):
        return FactorFindings((make_evidence_finding(one, "coverage.csv", _describe_control(one)),))
    rows = one.tables["coverage.csv"]
    wide, half = (rows[rows["level"] == level] for level in (rows["level"].max(), rows["level"].min()))
    names = _list_failing(one)
    verdict = f"NOT calibrated: {names}" if names else f"all {len(wide)} quantities inside what chance allows"
    synthetic = one.run["study"].get("truth") == "synthetic"
    proves = "It tests the model on one other" if synthetic else "It proves the computation, not the model"
    words = (
        f"{_count_truths(one)}: {verdict}; the {100 * wide['level'].max():.0f} % intervals held "
        f"{wide['covered'].min():.0f} to {wide['covered'].max():.0f} of {wide['replicates'].max()} (chance: "
        f"{wide['count_low'].min()} to {wide['count_high'].max()}). {proves}."
    )
    few = f"Whether these uncertainties are right: {_count_truths(one)} are too few to decide."
    return FactorFindings(
        (make_evidence_finding(one, "coverage.csv", words),),
        (f"{_name_target(case, one)}{few}",) if half["count_low"].min() <= 0 and not names else (),
        pictures=find_figure(
            one.folder, EVIDENCE_FIGURES[one.kind], f"{_name_target(case, one)}{labels.RANKS_CAPTION}"
        ),
    )


def _describe_control(one: CredibilityEvidence) -> str:
    noticed = f"noticed, by {_list_failing(one)}" if one.run["not_calibrated"] else "NOT noticed"
    return f"A control, {CONTROL_NAMES[one.run['control']]}, is {noticed} ({_count_truths(one)})."


def _count_truths(one: CredibilityEvidence) -> str:
    synthetic = one.run["study"].get("truth") == "synthetic"
    source = "synthetic truths of another model" if synthetic else "truths drawn from the prior"
    return f"{one.run['replicates']} {source}"


def _list_failing(one: CredibilityEvidence) -> str:
    return insert_symbols(", ".join(name_quantity(name) for name in one.run["not_calibrated"]))


def _describe_identification(one: CredibilityEvidence) -> list[str]:
    """Return the verdict on each parameter: of the fit where there is one, else of the design."""
    rows = one.tables["identify.csv"]
    last = "fit" if "fit" in set(rows["stage"]) else "design"
    summary = describe_verdicts(rows[rows["stage"] == last])
    return [f"By the {'measured shapes' if last == 'fit' else 'design alone'}:", *summary]


def _list_examined(case: CredibilityCase) -> list[str]:
    """Return the fits that examined their own parameters, which studies do not."""
    return [find_target(one) for one in case.results if len(one.frames["identification"])]


def _list_lacking(case: CredibilityCase, kind: str) -> list[str]:
    """Return of which runs there is no evidence of a kind that counts."""
    known = {one.target for one in case.evidence if one.kind == kind and one.counted}
    return [name for name in map(find_target, case.results) if name not in known]


def _name_target(case: CredibilityCase, evidence: CredibilityEvidence) -> str:
    return f"{evidence.target}: " if len(case.results) > 1 else ""
