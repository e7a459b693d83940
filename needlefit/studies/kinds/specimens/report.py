"""Report of a population of specimens: mean, spread and a further specimen; or recovery of a known
population.
"""

import math
from pathlib import Path

import pandas as pd

from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.labels import POPULATION_NAMES
from needlefit.reporting.number_format import (
    MISSING,
    format_bare_symbol,
    format_mm,
    format_quantity_range,
    insert_symbols,
    join_words,
)
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.specimens.figures import draw_densities, draw_recovered, draw_specimens
from needlefit.studies.kinds.specimens.run import BEST_DETERMINED, LEVELS
from needlefit.studies.kinds.specimens.schema import SpecimensRecord
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run

MAX_NAMED_SPECIMENS = 3
"""Number of specimens that a sentence names; more are only counted."""


def summarize(result: Run) -> list[str]:
    """Return sentences: the spread between specimens, or how often intervals covered a known one."""
    if result.frames["recovered"].empty:
        return [line for group in _list_groups(result) for line in _describe_population(result, group)]
    return _describe_recovery(result)


def _describe_population(result: Run, group: str) -> list[str]:
    every = result.frames["population"]
    mine = every[every["groups"] == group]
    spreads = to_records(mine[mine["quantity"] == "spread"])
    parts = "; ".join(f"{_name_parameter(row)} {_format_interval(row)}" for row in spreads)
    limits = ", ".join(_name_parameter(row) for row in spreads if row["low_95"] == 0)
    upper = [f"Only an upper limit of the spread is known, as the interval begins at 0: {limits}."]
    new = to_records(mine[(mine["quantity"] == "new") & (mine["parameter"] != BEST_DETERMINED)])
    further = "; ".join(f"{_name_parameter(row)} {_format_values(row)}" for row in new)
    count = f"{spreads[0]['specimens']} {group}s"
    return [
        f"Spread between {count} (SD of the logarithm, 95 % interval): {parts}.",
        *(upper if limits else []),
        f"Predicted for a further {group}, 95 % interval: {further}."
        f"{_describe_beyond_bounds(result, new, group)}",
        *_describe_near_bounds(result, group),
    ]


def _describe_beyond_bounds(result: Run, new: list[Row], group: str) -> str:
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
        f" This is outside the bounds of the fits: {', '.join(beyond)}. Outside them it is an extrapolation "
        "by the Gaussian of the population."
    )


def _describe_near_bounds(result: Run, group: str) -> list[str]:
    """Return whose posterior lies within two standard deviations of a bound, which then limits it."""
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
        f"Of {count} posteriors some lie within two SDs of a bound of the medium: {'; '.join(held)}. There "
        f"the spread and the further {group} depend on the bound."
    ]


def _find_bounds(result: Run) -> dict[str, tuple[float, float]]:
    """Return the bounds of the medium's free parameters: logarithms, of alpha itself."""
    (part, *_) = result.run["parts"]
    given = {name: one["bounds"] for name, one in part["medium"]["parameters"].items() if one["bounds"]}
    return {
        name: (math.log(low), math.log(high)) if _is_logarithmic(name) else (low, high)
        for name, (low, high) in given.items()
    }


def _describe_recovery(result: Run) -> list[str]:
    coverage, recovery = result.frames["coverage"], _record(result).recovery
    assert recovery is not None
    levels = [_describe_covered(rows) for _, rows in coverage.groupby("level", sort=False)]
    lines = [f"Of known populations, {join_words(levels)}."]
    times = "once" if recovery.replicates == 1 else f"{recovery.replicates} times"
    lines.append(f"{recovery.specimens} synthetic specimens of each true spread were simulated {times}.")
    for spread, same in coverage[coverage["quantity"] == "spread"].groupby("spread", sort=False):
        counts = [
            f"{_name_parameter(row)} {row['covered']} of {row['replicates']} ({100 * row['level']:.0f} %)"
            for row in to_records(same)
        ]
        lines.append(f"True spread {spread:g}, intervals that contain it: {'; '.join(counts)}.")
    found = result.frames["recovered"].drop_duplicates(["spread", "replicate"])
    uncertified = int((~found["certified"].astype(bool)).sum())
    if uncertified:
        lines.append(
            f"The draws of {uncertified} of {len(found)} populations are not certified; they are counted."
        )
    return lines


def _describe_covered(rows: pd.DataFrame) -> str:
    """Return how many intervals of one level contain the truth, of means and spreads."""
    counts = rows.groupby("quantity", sort=False)[["covered", "replicates"]].sum()
    parts = [
        f"{int(row['covered'])} of {int(row['replicates'])} {quantity}s"
        for quantity, row in counts.iterrows()
    ]
    return f"the {100 * float(rows['level'].iloc[0]):.0f} % intervals contain {join_words(parts)}"


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return mean, spread and a further specimen as tables; or the coverage of the intervals."""
    return [_lay_out_coverage(result)] if len(result.frames["coverage"]) else [_lay_out_population(result)]


def _lay_out_population(result: Run) -> TableLayout:
    rows = [
        {
            **row,
            "specimens_of": f"{row['specimens']} {row['groups']}s",
            "parameter": _name_parameter(row),
            "population_quantity": POPULATION_NAMES[row["quantity"]],
            "own_units_95": _format_own_units(row),
        }
        for row in to_records(result.frames["population"])
    ]
    columns = (
        *("specimens_of", "parameter", "population_quantity", "population_median", "log_range_50"),
        *("log_range_95", "own_units_95"),
    )
    prior = _record(result).spread_prior_sd
    notes = (
        "Of logarithms (of alpha itself). Intervals of spreads are the shortest, and may begin at 0; the "
        f"others are central. Prior of every spread: half-normal, SD {prior:g}. The posterior of each "
        "specimen is in specimens.csv.",
    )
    caption = "Population of specimens: mean, spread, and a further specimen."
    return Table("population", caption, rows, columns, groups=("groups",), notes=notes).lay_out()


def _format_own_units(row: Row) -> str:
    unitless = row["quantity"] == "spread" or row["parameter"] == BEST_DETERMINED
    return MISSING if unitless else _format_values(row)


def _lay_out_coverage(result: Run) -> TableLayout:
    rows = [
        {
            **row,
            "population_quantity": POPULATION_NAMES[str(row["quantity"])],
            "parameter": _name_parameter(row),
        }
        for row in to_records(result.frames["coverage"])
    ]
    levels = (part(key, level=level) for level in LEVELS for key in ("held_share", "interval_width"))
    columns = ("true_spread", "population_quantity", "parameter", *levels)
    notes = (
        "Coverage: how often the interval contains the truth (brackets: 95 % Wilson interval of that share). "
        "Width: median. A true spread of 0 is contained only if the shortest interval begins at 0. Bayesian "
        "intervals have their nominal coverage on average over the prior, not at every truth.",
    )
    caption = "Coverage of the intervals of a known population."
    populations = pivot(rows, ["spread", "quantity", "parameter"], ["level"])
    return Table("coverage", caption, populations, columns, notes=notes).lay_out()


def draw_figures(result: Run, folder: Path) -> dict[str, Path]:
    """Draw specimens and spreads, or the intervals of every replicate beside the true values."""
    if len(result.frames["coverage"]):
        return {"recovered": draw_recovered(result, folder / "recovered.pdf")}
    return {
        "specimens": draw_specimens(result, folder / "specimens.pdf"),
        "densities": draw_densities(result, folder / "densities.pdf"),
    }


def compose_sections(result: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: figures, table, and the basis of the numbers."""
    captions = {
        "specimens": "Posterior of each specimen alone: mean and SD.",
        "densities": "Posterior density of the spread between specimens. Dashed: prior.",
        "recovered": "Intervals of 50 % (thick) and 95 % (thin) of every replicate. Orange: truth.",
    }
    drawn = [document.figure(path, captions[name]) for name, path in figures.items()]
    tables = [document.table(table) for table in lay_out_tables(result)]
    heading = "Recovered populations" if len(result.frames["coverage"]) else "The population"
    return [
        document.heading(heading),
        *drawn,
        *tables,
        document.heading("Method"),
        document.text(METHOD_NOTE),
    ]


METHOD_NOTE = (
    "Stage one samples the posterior of each specimen alone, with a flat prior. Stage two reweights these "
    "draws by a population in which the logarithms of the parameters are independent Gaussians. Each draw "
    "is a kernel that keeps mean and covariance of its posterior, so that the ridge of μ and b (or θ) stays "
    "and a spread of 0 is possible. The combination is the best-determined one. Differences within a "
    "specimen (from place to place, with the bevel direction) are not in the model: they appear as "
    "differences between specimens, or make intervals too narrow."
)


def _list_groups(result: Run) -> list[str]:
    return [str(group) for group in result.frames["population"]["groups"].unique()]


def _record(result: Run) -> SpecimensRecord:
    assert isinstance(result.record, SpecimensRecord)
    return result.record


def _is_logarithmic(name: str) -> bool:
    """Return whether a row is of a logarithm: every combination is."""
    return name == BEST_DETERMINED or is_logarithmic(name)


def _name_parameter(row: Row) -> str:
    if row["parameter"] == BEST_DETERMINED:
        return insert_symbols(str(row["combination"]))
    return format_bare_symbol(str(row["parameter"]))


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
    return format_quantity_range(name, low, high)


REPORT = StudyReport(summarize, lay_out_tables, draw_figures, compose_sections)
