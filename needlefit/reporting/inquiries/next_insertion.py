"""What is told of the insertion to make next: what each candidate would tell, and what none can."""

from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.inference.identifiability.information import describe_precision, short_name
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.gains import draw_gains
from needlefit.reporting.inquiries import ways_in
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import way_in_name
from needlefit.reporting.numbers import fixed, in_symbols, symbol
from needlefit.reporting.tables import Row, records
from needlefit.validation.analyses.planning.next_insertion import LEAST_KNOWN, ROUGH_NOTE
from needlefit.validation.analyses.runner import AnalysisResult

BENT = 0.3
"""Nats by which a linear gain must be too large for the ridge to be called bent: several standard errors."""


def said(answer: AnalysisResult) -> list[str]:
    """Return the best candidate, what it tells beside a repeat, and what none tells."""
    best, again = ways_in.best(answer), ways_in.repeat(answer)
    if best is None:
        return ["No candidate has a solution within the medium."]
    layers = f"layer{'s' if '-' in best['layers'] else ''} {best['layers']}"
    repeated = ""
    if again is not None:
        where = f"{again['entry']}, {again['depth_mm']:.1f} mm"
        repeated = f" Once more the deepest insertion so far ({where}) would tell {_nats(again)} nats."
    return [
        f"Most is told by an insertion {_name(best)}, {best['depth_mm']:g} mm deep, through {layers}: "
        f"{_nats(best)} nats about all parameters together are expected.{repeated}",
        _parameters_said(answer, best),
        *(_tip_said(answer, str(name)) for name in answer.frames["tips"]["tip"].unique()),
        *_alphas_said(answer),
        _agreement_said(answer),
    ]


def _parameters_said(answer: AnalysisResult, best: Row) -> str:
    parts = []
    for row in records(ways_in.about(answer.frames["parameters"], best)):
        name = str(row["parameter"])
        now, after = (_known(name, row[key]) for key in ("sd_now", "sd_after"))
        called = symbol(name).split(" (")[0]
        if name == LEAST_KNOWN:
            called = f"the combination known worst, {in_symbols(str(row['combination']))},"
        parts.append(f"{called} {after} (now {now})")
    return f"What would then be known: {'; '.join(parts)}."


def _known(name: str, sd: float) -> str:
    return describe_precision(sd, name == LEAST_KNOWN or is_logarithmic(name))


def _tip_said(answer: AnalysisResult, name: str) -> str:
    """Return which candidate tells most about a tip."""
    every = answer.frames["tips"]
    mine = every[(every["tip"] == name) & (every["role"] == "candidate")]
    row = records(mine.sort_values("sd_after_mm", kind="stable"))[0]
    return (
        f"Most about the {name} is told {_name(row)}, {row['depth_mm']:g} mm deep: its deviation falls from "
        f"{fixed(row['sd_now_mm'])} to {fixed(row['sd_after_mm'])} mm."
    )


def _alphas_said(answer: AnalysisResult) -> list[str]:
    every = answer.frames["alphas"]
    if every.empty:
        return []
    left = float((every["sd_after"] / every["sd_before"]).min())
    names = " and ".join(symbol(str(name)) for name in every["parameter"].unique())
    return [
        f"No candidate tells {names}: even with all else known, the deviation of a flat prior between −3 and "
        f"5 would stay {100 * left:.1f} % of what it is."
    ]


def _agreement_said(answer: AnalysisResult) -> str:
    row = records(answer.frames["agreement"])[0]
    if row["spearman"] is None:
        return "There are too few candidates to compare the linear gain with."
    first = "the same candidate" if row["same_best"] else "another candidate"
    excess = float(row["largest_excess_nats"])
    bent = ", for one covariance makes a bent ridge too thick" if excess > BENT else ""
    return (
        f"Linearised (Σ of the draws, J at each), {first} is first and the rank correlation over "
        f"{row['candidates']} candidates is {row['spearman']:.2f}; the linear gain is up to {excess:.1f} "
        f"nats larger{bent}."
    )


def layouts(answer: AnalysisResult) -> list[Display]:
    """Return the best depth of every way in beside a repeat, and the deviations that the best leaves."""
    return [_ranking(answer), _left(answer)]


def _ranking(answer: AnalysisResult) -> Display:
    again, tips = ways_in.repeat(answer), answer.frames["tips"]
    ways = [max(rows, key=lambda row: float(row["nats"])) for rows in ways_in.ways(answer).values()]
    shown = sorted(ways, key=lambda row: -float(row["nats"])) + ([again] if again is not None else [])
    names = [str(name) for name in tips["tip"].unique()]
    columns = (
        *(text("Way in", wide=True), text("Layers"), Column("Depth", "mm"), Column("Tip", "mm")),
        *(Column("Gain", "nats"), Column("Linearised", "nats"), Column("sd, worst known", "ln")),
        *(Column(f"sd, {name}", "mm") for name in names),
    )
    now = [f"{fixed(_first(tips[tips['tip'] == name], 'sd_now_mm'))} mm of the {name}" for name in names]
    known = answer.frames["parameters"]
    worst = (
        f"{fixed(_first(known[known['parameter'] == LEAST_KNOWN], 'sd_now'))} of the combination known worst"
    )
    note = (
        "The depth at which each way in tells most. Gain: expected fall of entropy, ± its standard error; "
        f"deviations are those expected afterwards; now they are {' and '.join([worst, *now])}. All "
        "candidates are in candidates.csv, parameters.csv and tips.csv."
    )
    caption = "What one more insertion is expected to tell."
    rows = tuple(_cells(answer, row) for row in shown)
    return Display("next_insertion", caption, columns, rows, strong=(0,), notes=(note,))


def _cells(answer: AnalysisResult, row: Row) -> tuple[str, ...]:
    known = ways_in.about(answer.frames["parameters"], row)
    worst = _first(known[known["parameter"] == LEAST_KNOWN], "sd_after")
    ends = (fixed(float(sd)) for sd in ways_in.about(answer.frames["tips"], row)["sd_after_mm"])
    way = "once more" if row["role"] == "repeat" else _name(row)
    mark = f" ({row['note']})" if row["note"] else ""
    where = (way, str(row["layers"]), f"{row['depth_mm']:.3g}", fixed(row["tip_mm"]))
    return (*where, _nats(row), fixed(row["linear_nats"]), f"{fixed(worst)}{mark}", *ends)


def _left(answer: AnalysisResult) -> Display:
    """Return how well parameters are known now, and would be."""
    found = [one for one in (ways_in.best(answer), ways_in.repeat(answer)) if one is not None]
    each = [records(ways_in.about(answer.frames["parameters"], one)) for one in found]
    rows = []
    for same in zip(*each, strict=True):
        name = str(same[0]["parameter"])
        called = str(same[0]["combination"]) if name == LEAST_KNOWN else short_name(name)
        after = (_known(name, row["sd_after"]) for row in same)
        rows.append((in_symbols(called), _known(name, same[0]["sd_now"]), *after))
    heads = ("Known now", "After the best", "After a repeat")[: 1 + len(found)]
    columns = (text("What"), *(text(head) for head in heads))
    return Display("left", "How well parameters would be known.", columns, tuple(rows))


def draw_all(answer: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw what every insertion would tell, if any has a solution."""
    return {} if ways_in.best(answer) is None else {"gains": draw_gains(answer, folder / "gains.pdf")}


def story(answer: AnalysisResult, figures: Figures) -> list[Block]:
    """Return figure, tables, and what is behind the numbers."""
    caption = (
        "Expected gain of one more insertion (with its standard error), and the deviation of the tip asked "
        "for that it is expected to leave, against its depth. Diamond: the deepest insertion so far again."
    )
    drawn = [document.figure(path, caption, answer.synthetic) for path in figures.values()]
    tables = [document.table(table, answer.synthetic) for table in layouts(answer)] if figures else []
    behind = [document.text(_behind(row, answer)) for row in records(answer.frames["posterior"])]
    return [document.heading("What each would tell"), *drawn, *tables, document.heading("How"), *behind]


def _behind(row: Row, answer: AnalysisResult) -> str:
    rough = int((answer.frames["candidates"]["note"] == ROUGH_NOTE).sum())
    source = "sampled" if row["sampled"] else f"weighed (Pareto k {row['pareto_k']:.2f})"
    made = f"{row['insertions']} insertion{'s' if row['insertions'] > 1 else ''}"
    marked = f" {rough} candidates leave so few draws that deviations are rough (marked)." if rough else ""
    return (
        f"The posterior of the {made} made so far is {source}: {row['draws']} draws, worth "
        f"{row['ess']:.0f} independent ones. Some of them foretell data, with errors of pose, depths "
        "and points as in the dataset, and all are weighed anew by these data (nested Monte Carlo): the mean "
        "fall of entropy is the gain, and the new weights give the deviations. A gain of 1 nat divides the "
        f"volume of what is possible by 2.7.{marked} What the model misses is not in it: an insertion that "
        "checks the model may be worth more than one that narrows its parameters."
    )


def _first(frame: pd.DataFrame, column: str) -> float:
    return float(frame[column].to_numpy(dtype=np.float64)[0])


def _name(row: Row) -> str:
    return way_in_name(str(row["entry"]), float(row["angle_deg"]))


def _nats(row: Row) -> str:
    return f"{row['nats']:.2f} ± {row['nats_se']:.2f}"


PAGE = Page(said, layouts, draw_all, story)
