"""Report of a population of specimens: mean, spread and a further specimen; or recovery of a known
population.
"""

import math
from pathlib import Path

from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting import document
from needlefit.reporting.analyses.page import AnalysisPage, FigurePaths
from needlefit.reporting.document import Block
from needlefit.reporting.figures.specimens import draw_densities, draw_recovered, draw_specimens
from needlefit.reporting.labels import POPULATION_NAMES
from needlefit.reporting.number_format import format_mm, format_number, format_symbol, insert_symbols, typeset
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.schemas.analyses import SpecimensRecord
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.analyses.specimens import BEST_DETERMINED, LEVELS

MAX_NAMED_SPECIMENS = 3
"""Number of specimens that a sentence names; more are only counted."""


def summarize(result: AnalysisResult) -> list[str]:
    """Return sentences: the spread between specimens, or how often intervals covered a known one."""
    if result.frames["recovered"].empty:
        return [line for group in _list_groups(result) for line in _describe_population(result, group)]
    return _describe_recovery(result)


def _describe_population(result: AnalysisResult, group: str) -> list[str]:
    every = result.frames["population"]
    mine = every[every["groups"] == group]
    spreads = to_records(mine[mine["quantity"] == "spread"])
    parts = "; ".join(f"{_name_parameter(row)} {_format_interval(row)}" for row in spreads)
    limits = ", ".join(_name_parameter(row) for row in spreads if row["low_95"] == 0)
    reach = f" What begins at 0 tells no spread, only a limit of it ({limits})." if limits else ""
    new = to_records(mine[(mine["quantity"] == "new") & (mine["parameter"] != BEST_DETERMINED)])
    further = "; ".join(f"{_name_parameter(row)} {_format_values(row)}" for row in new)
    count = f"{spreads[0]['specimens']} {group}s"
    return [
        f"Spread between {count} (standard deviation of the logarithm, 95 %): {parts}.{reach}",
        f"A further {group}, 95 %: {further}.{_describe_beyond_bounds(result, new, group)}",
        *_describe_near_bounds(result, group),
    ]


def _describe_beyond_bounds(result: AnalysisResult, new: list[Row], group: str) -> str:
    """Return where the interval of a further specimen leaves the medium's bounds, which no fit ever did."""
    ends = _find_bounds(result)
    beyond = [
        f"{_name_parameter(row)} ({_format_ends(row['parameter'], *ends[row['parameter']])})"
        for row in new
        if row["parameter"] in ends
        and (row["low_95"] < ends[row["parameter"]][0] or row["high_95"] > ends[row["parameter"]][1])
    ]
    if not beyond:
        return ""
    return (
        f" That leaves the bounds within which the medium is fitted: {', '.join(beyond)}. Beyond them a "
        f"further {group} is what the Gaussian of the population makes it, not what was seen."
    )


def _describe_near_bounds(result: AnalysisResult, group: str) -> list[str]:
    """Return whose posterior lies within two standard deviations of a bound: it is the bound that ends it."""
    ends, every = _find_bounds(result), result.frames["specimens"]
    mine = every[every["groups"] == group]
    count, held = mine["specimen"].nunique(), []
    for name, rows in mine[mine["parameter"].isin(list(ends))].groupby("parameter", sort=False):
        low, high = ends[str(name)]
        near = rows[rows["mean"].sub(low).combine(high - rows["mean"], min) < 2 * rows["sd"]]
        if len(near):
            which = (
                ", ".join(map(str, near["specimen"]))
                if len(near) <= MAX_NAMED_SPECIMENS
                else f"{len(near)} {group}s"
            )
            held.append(f"{_name_parameter({'parameter': name})} of {which}")
    if not held:
        return []
    return [
        f"Of {count} posteriors some lie within two standard deviations of a bound of the medium: "
        f"{'; '.join(held)}. There the bound ends what the data leave open, and spread and further {group} "
        "depend on it."
    ]


def _find_bounds(result: AnalysisResult) -> dict[str, tuple[float, float]]:
    """Return the bounds of the medium's free parameters: logarithms, of alpha itself."""
    (part, *_) = result.run["parts"]
    given = {name: one["bounds"] for name, one in part["medium"]["parameters"].items() if one["bounds"]}
    return {
        name: (math.log(low), math.log(high)) if _is_logarithmic(name) else (low, high)
        for name, (low, high) in given.items()
    }


def _describe_recovery(result: AnalysisResult) -> list[str]:
    coverage, recovery = result.frames["coverage"], _record(result).recovery
    assert recovery is not None
    lines = [f"{recovery.replicates} times {recovery.specimens} made-up specimens of each known spread."]
    for spread, same in coverage[coverage["quantity"] == "spread"].groupby("spread", sort=False):
        counts = [
            f"{_name_parameter(row)} {row['covered']} of {row['replicates']} ({100 * row['level']:.0f} %)"
            for row in to_records(same)
        ]
        reached = "reached 0" if spread == 0 else f"held {spread:g}"
        lines.append(f"True spread {spread:g}: intervals that {reached}: {'; '.join(counts)}.")
    for level, same in coverage[coverage["quantity"] == "mean"].groupby("level", sort=False):
        held, count = int(same["covered"].sum()), int(same["replicates"].sum())
        percent = f"{100 * float(str(level)):.0f} %"
        lines.append(f"Of the means, {held} of {count} lay in their {percent} intervals.")
    found = result.frames["recovered"].drop_duplicates(["spread", "replicate"])
    doubtful = int((~found["certified"].astype(bool)).sum())
    if doubtful:
        lines.append(f"What is told of {doubtful} of {len(found)} populations is not certified; it counts.")
    return lines


def lay_out_tables(result: AnalysisResult) -> list[TableLayout]:
    """Return mean, spread and a further specimen as tables; or the coverage of the intervals."""
    return [_lay_out_coverage(result)] if len(result.frames["coverage"]) else [_lay_out_population(result)]


def _lay_out_population(result: AnalysisResult) -> TableLayout:
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for group in _list_groups(result):
        breaks += [len(rows)] if rows else []
        mine = result.frames["population"]
        for row in to_records(mine[mine["groups"] == group]):
            ends = (
                _replace_minus(f"{format_mm(row[f'low_{p}'])} to {format_mm(row[f'high_{p}'])}")
                for p in (50, 95)
            )
            values = (
                _format_values(row)
                if row["quantity"] != "spread" and row["parameter"] != BEST_DETERMINED
                else "–"
            )
            median = _replace_minus(format_mm(row["median"]))
            rows.append(
                (
                    f"{row['specimens']} {group}s",
                    _name_parameter(row),
                    POPULATION_NAMES[row["quantity"]],
                    median,
                    *ends,
                    values,
                )
            )
    columns = (
        *(
            text_column("Specimens"),
            text_column("Parameter"),
            text_column("What"),
            TableColumn("Median", "ln"),
        ),
        *(TableColumn("50 %", "ln"), TableColumn("95 %", "ln"), text_column("95 %, in Pa or mm")),
    )
    prior = _record(result).spread_prior_sd
    notes = (
        "Of logarithms (of alpha itself). Intervals of spreads are the shortest, and may begin at 0; the "
        f"others are central. Prior of every spread: half-normal of standard deviation {prior:g}. Each "
        "specimen's own posterior is in specimens.csv.",
    )
    caption = "The population that the specimens come from."
    return TableLayout("population", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _lay_out_coverage(result: AnalysisResult) -> TableLayout:
    coverage = result.frames["coverage"]
    rows = []
    for (spread, group, parameter), same in coverage.groupby(["spread", "quantity", "parameter"], sort=False):
        by_level = {row["level"]: row for row in to_records(same)}
        cells = []
        for level in LEVELS:
            row = by_level[level]
            ends = f"{100 * row['low']:.0f}–{100 * row['high']:.0f} %"
            cells += [f"{row['covered']} of {row['replicates']} ({ends})", format_mm(row["width"])]
        rows.append(
            (f"{spread:g}", POPULATION_NAMES[str(group)], _name_parameter({"parameter": parameter}), *cells)
        )
    pairs = [(TableColumn(f"{100 * level:.0f} % held"), TableColumn("width", "ln")) for level in LEVELS]
    heads = (one for pair in pairs for one in pair)
    columns = (TableColumn("True spread"), text_column("What"), text_column("Parameter"), *heads)
    notes = (
        "How often the interval held the truth (in brackets Wilson's 95 % interval of that share), and its "
        "median width. Where the true spread is 0 the shortest interval holds it only if it begins at 0. "
        "Bayesian intervals hold at their level on average over the prior, not at every truth.",
    )
    caption = "Whether a known population is found again."
    return TableLayout("coverage", caption, columns, tuple(rows), notes=notes)


def draw_figures(result: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw specimens and spreads, or the intervals of every replicate beside the true values."""
    if len(result.frames["coverage"]):
        return {"recovered": draw_recovered(result, folder / "recovered.pdf")}
    return {
        "specimens": draw_specimens(result, folder / "specimens.pdf"),
        "densities": draw_densities(result, folder / "densities.pdf"),
    }


def compose_sections(result: AnalysisResult, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: figures, table, and the basis of the numbers."""
    captions = {
        "specimens": "The posterior of every specimen by itself: mean and standard deviation.",
        "densities": "Posterior density of the spread between specimens; dashed its prior.",
        "recovered": "Intervals of 50 % (thick) and 95 % (thin) of every replicate; orange the truth.",
    }
    drawn = [document.figure(path, captions[name], result.synthetic) for name, path in figures.items()]
    tables = [document.table(table, result.synthetic) for table in lay_out_tables(result)]
    heading = "What is found again" if len(result.frames["coverage"]) else "The population"
    return [document.heading(heading), *drawn, *tables, document.heading("How"), document.text(METHOD_NOTE)]


METHOD_NOTE = (
    "Stage one is the posterior of every specimen by itself, with a flat prior; stage two weighs its draws "
    "anew by a population in which parameters vary independently, as Gaussians in the logarithm. Draws stand "
    "for kernels that keep each posterior's mean and covariance, so that the ridge of μ and b stays, and a "
    "spread of 0 is possible. The combination is the one that the specimens tell best. What differs within a "
    "specimen, from place to place or with the bevel's direction, is not in the model: it is taken for a "
    "difference between specimens, or leaves intervals too narrow."
)


def _list_groups(result: AnalysisResult) -> list[str]:
    return [str(group) for group in result.frames["population"]["groups"].unique()]


def _record(result: AnalysisResult) -> SpecimensRecord:
    assert isinstance(result.record, SpecimensRecord)
    return result.record


def _is_logarithmic(name: str) -> bool:
    """Return whether a row is of a logarithm: every combination is."""
    return name == BEST_DETERMINED or is_logarithmic(name)


def _name_parameter(row: Row) -> str:
    if row["parameter"] == BEST_DETERMINED:
        return insert_symbols(str(row["combination"]))
    return format_symbol(str(row["parameter"])).split(" (")[0]


def _replace_minus(words: str) -> str:
    return words.replace("-", "−")


def _format_interval(row: Row) -> str:
    return f"{format_mm(row['low_95'])} to {format_mm(row['high_95'])}"


def _format_values(row: Row) -> str:
    """Return the 95 % interval of a parameter in its own unit."""
    return _format_ends(str(row["parameter"]), row["low_95"], row["high_95"])


def _format_ends(name: str, *ends: float) -> str:
    """Return two ends in the parameter's own unit; those of a logarithmic parameter are converted."""
    low, high = (math.exp(end) if _is_logarithmic(name) else end for end in ends)
    unit = {"_pa": " Pa", "_mm": " mm"}.get(name[-3:], "")
    return f"{typeset(format_number(low))} to {typeset(format_number(high))}{unit}"


PAGE = AnalysisPage(summarize, lay_out_tables, draw_figures, compose_sections)
