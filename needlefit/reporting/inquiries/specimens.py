"""What is told of a population of specimens: its mean, its spread, a further specimen; and of a known one."""

import math
from pathlib import Path

from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.specimens import draw_densities, draw_recovered, draw_specimens
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import POPULATION_NAMES
from needlefit.reporting.numbers import fixed, in_symbols, number, symbol, typeset
from needlefit.reporting.tables import Row, records
from needlefit.schemas.analyses import SpecimensRecord
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.analyses.specimens import BEST_DETERMINED, LEVELS

NAMED = 3
"""Specimens at most that a sentence names; more are counted."""


def said(answer: AnalysisResult) -> list[str]:
    """Return what the spread between specimens can be, or how often intervals held a known one."""
    if answer.frames["recovered"].empty:
        return [line for what in _groups(answer) for line in _population_said(answer, what)]
    return _recovery_said(answer)


def _population_said(answer: AnalysisResult, what: str) -> list[str]:
    every = answer.frames["population"]
    mine = every[every["groups"] == what]
    spreads = records(mine[mine["quantity"] == "spread"])
    parts = "; ".join(f"{_name(row)} {_interval(row)}" for row in spreads)
    limits = ", ".join(_name(row) for row in spreads if row["low_95"] == 0)
    reach = f" What begins at 0 tells no spread, only a limit of it ({limits})." if limits else ""
    new = records(mine[(mine["quantity"] == "new") & (mine["parameter"] != BEST_DETERMINED)])
    further = "; ".join(f"{_name(row)} {_values(row)}" for row in new)
    count = f"{spreads[0]['specimens']} {what}s"
    return [
        f"Spread between {count} (standard deviation of the logarithm, 95 %): {parts}.{reach}",
        f"A further {what}, 95 %: {further}.{_beyond_bounds(answer, new, what)}",
        *_pressing(answer, what),
    ]


def _beyond_bounds(answer: AnalysisResult, new: list[Row], what: str) -> str:
    """Return where the interval of a further specimen leaves the medium's bounds, which no fit ever did."""
    ends = _bounds(answer)
    beyond = [
        f"{_name(row)} ({_between(row['parameter'], *ends[row['parameter']])})"
        for row in new
        if row["parameter"] in ends
        and (row["low_95"] < ends[row["parameter"]][0] or row["high_95"] > ends[row["parameter"]][1])
    ]
    if not beyond:
        return ""
    return (
        f" That leaves the bounds within which the medium is fitted: {', '.join(beyond)}. Beyond them a "
        f"further {what} is what the Gaussian of the population makes it, not what was seen."
    )


def _pressing(answer: AnalysisResult, what: str) -> list[str]:
    """Return whose posterior lies within two standard deviations of a bound: it is the bound that ends it."""
    ends, every = _bounds(answer), answer.frames["specimens"]
    mine = every[every["groups"] == what]
    count, held = mine["specimen"].nunique(), []
    for name, rows in mine[mine["parameter"].isin(list(ends))].groupby("parameter", sort=False):
        low, high = ends[str(name)]
        near = rows[rows["mean"].sub(low).combine(high - rows["mean"], min) < 2 * rows["sd"]]
        if len(near):
            which = ", ".join(map(str, near["specimen"])) if len(near) <= NAMED else f"{len(near)} {what}s"
            held.append(f"{_name({'parameter': name})} of {which}")
    if not held:
        return []
    return [
        f"Of {count} posteriors some lie within two standard deviations of a bound of the medium: "
        f"{'; '.join(held)}. There the bound ends what the data leave open, and spread and further {what} "
        "depend on it."
    ]


def _bounds(answer: AnalysisResult) -> dict[str, tuple[float, float]]:
    """Return the bounds of the medium's free parameters: logarithms, of alpha itself."""
    (part, *_) = answer.run["parts"]
    given = {name: one["bounds"] for name, one in part["medium"]["parameters"].items() if one["bounds"]}
    return {
        name: (math.log(low), math.log(high)) if _in_log(name) else (low, high)
        for name, (low, high) in given.items()
    }


def _recovery_said(answer: AnalysisResult) -> list[str]:
    coverage, made = answer.frames["coverage"], _record(answer).recovery
    assert made is not None
    lines = [f"{made.replicates} times {made.specimens} made-up specimens of each known spread."]
    for spread, same in coverage[coverage["quantity"] == "spread"].groupby("spread", sort=False):
        counts = [
            f"{_name(row)} {row['covered']} of {row['replicates']} ({100 * row['level']:.0f} %)"
            for row in records(same)
        ]
        reached = "reached 0" if spread == 0 else f"held {spread:g}"
        lines.append(f"True spread {spread:g}: intervals that {reached}: {'; '.join(counts)}.")
    for level, same in coverage[coverage["quantity"] == "mean"].groupby("level", sort=False):
        held, count = int(same["covered"].sum()), int(same["replicates"].sum())
        percent = f"{100 * float(str(level)):.0f} %"
        lines.append(f"Of the means, {held} of {count} lay in their {percent} intervals.")
    found = answer.frames["recovered"].drop_duplicates(["spread", "replicate"])
    doubtful = int((~found["certified"].astype(bool)).sum())
    if doubtful:
        lines.append(f"What is told of {doubtful} of {len(found)} populations is not certified; it counts.")
    return lines


def layouts(answer: AnalysisResult) -> list[Display]:
    """Return mean, spread and further specimen; or how often intervals held."""
    return [_coverage(answer)] if len(answer.frames["coverage"]) else [_population(answer)]


def _population(answer: AnalysisResult) -> Display:
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for what in _groups(answer):
        breaks += [len(rows)] if rows else []
        mine = answer.frames["population"]
        for row in records(mine[mine["groups"] == what]):
            ends = (_signed(f"{fixed(row[f'low_{p}'])} to {fixed(row[f'high_{p}'])}") for p in (50, 95))
            values = (
                _values(row) if row["quantity"] != "spread" and row["parameter"] != BEST_DETERMINED else "–"
            )
            median = _signed(fixed(row["median"]))
            rows.append(
                (
                    f"{row['specimens']} {what}s",
                    _name(row),
                    POPULATION_NAMES[row["quantity"]],
                    median,
                    *ends,
                    values,
                )
            )
    columns = (
        *(text("Specimens"), text("Parameter"), text("What"), Column("Median", "ln")),
        *(Column("50 %", "ln"), Column("95 %", "ln"), text("95 %, in Pa or mm")),
    )
    prior = _record(answer).spread_prior_sd
    notes = (
        "Of logarithms (of alpha itself). Intervals of spreads are the shortest, and may begin at 0; the "
        f"others are central. Prior of every spread: half-normal of standard deviation {prior:g}. Each "
        "specimen's own posterior is in specimens.csv.",
    )
    caption = "The population that the specimens come from."
    return Display("population", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _coverage(answer: AnalysisResult) -> Display:
    coverage = answer.frames["coverage"]
    rows = []
    for (spread, what, parameter), same in coverage.groupby(["spread", "quantity", "parameter"], sort=False):
        by_level = {row["level"]: row for row in records(same)}
        cells = []
        for level in LEVELS:
            row = by_level[level]
            ends = f"{100 * row['low']:.0f}–{100 * row['high']:.0f} %"
            cells += [f"{row['covered']} of {row['replicates']} ({ends})", fixed(row["width"])]
        rows.append((f"{spread:g}", POPULATION_NAMES[str(what)], _name({"parameter": parameter}), *cells))
    pairs = [(Column(f"{100 * level:.0f} % held"), Column("width", "ln")) for level in LEVELS]
    heads = (one for pair in pairs for one in pair)
    columns = (Column("True spread"), text("What"), text("Parameter"), *heads)
    notes = (
        "How often the interval held the truth (in brackets Wilson's 95 % interval of that share), and its "
        "median width. Where the true spread is 0 the shortest interval holds it only if it begins at 0. "
        "Bayesian intervals hold at their level on average over the prior, not at every truth.",
    )
    caption = "Whether a known population is found again."
    return Display("coverage", caption, columns, tuple(rows), notes=notes)


def draw_all(answer: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw specimens and spreads, or the intervals of every replicate beside the truth."""
    if len(answer.frames["coverage"]):
        return {"recovered": draw_recovered(answer, folder / "recovered.pdf")}
    return {
        "specimens": draw_specimens(answer, folder / "specimens.pdf"),
        "densities": draw_densities(answer, folder / "densities.pdf"),
    }


def story(answer: AnalysisResult, figures: Figures) -> list[Block]:
    """Return figures, table, and what is behind them."""
    captions = {
        "specimens": "The posterior of every specimen by itself: mean and standard deviation.",
        "densities": "Posterior density of the spread between specimens; dashed its prior.",
        "recovered": "Intervals of 50 % (thick) and 95 % (thin) of every replicate; orange the truth.",
    }
    drawn = [document.figure(path, captions[name], answer.synthetic) for name, path in figures.items()]
    tables = [document.table(table, answer.synthetic) for table in layouts(answer)]
    heading = "What is found again" if len(answer.frames["coverage"]) else "The population"
    return [document.heading(heading), *drawn, *tables, document.heading("How"), document.text(HOW)]


HOW = (
    "Stage one is the posterior of every specimen by itself, with a flat prior; stage two weighs its draws "
    "anew by a population in which parameters vary independently, as Gaussians in the logarithm. Draws stand "
    "for kernels that keep each posterior's mean and covariance, so that the ridge of μ and b stays, and a "
    "spread of 0 is possible. The combination is the one that the specimens tell best. What differs within a "
    "specimen, from place to place or with the bevel's direction, is not in the model: it is taken for a "
    "difference between specimens, or leaves intervals too narrow."
)


def _groups(answer: AnalysisResult) -> list[str]:
    return [str(what) for what in answer.frames["population"]["groups"].unique()]


def _record(answer: AnalysisResult) -> SpecimensRecord:
    assert isinstance(answer.record, SpecimensRecord)
    return answer.record


def _in_log(name: str) -> bool:
    """Return whether a row is of a logarithm: every combination is."""
    return name == BEST_DETERMINED or is_logarithmic(name)


def _name(row: Row) -> str:
    if row["parameter"] == BEST_DETERMINED:
        return in_symbols(str(row["combination"]))
    return symbol(str(row["parameter"])).split(" (")[0]


def _signed(words: str) -> str:
    return words.replace("-", "−")


def _interval(row: Row) -> str:
    return f"{fixed(row['low_95'])} to {fixed(row['high_95'])}"


def _values(row: Row) -> str:
    """Return the 95 % interval of a parameter in its own unit."""
    return _between(str(row["parameter"]), row["low_95"], row["high_95"])


def _between(name: str, *ends: float) -> str:
    """Return two ends, of logarithms where the parameter is told as one, in the parameter's own unit."""
    low, high = (math.exp(end) if _in_log(name) else end for end in ends)
    unit = {"_pa": " Pa", "_mm": " mm"}.get(name[-3:], "")
    return f"{typeset(number(low))} to {typeset(number(high))}{unit}"


PAGE = Page(said, layouts, draw_all, story)
