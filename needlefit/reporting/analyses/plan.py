"""Report of a plan: expected misses of the plan and of the alternative plans."""

from collections.abc import Collection
from pathlib import Path

from needlefit.reporting import document
from needlefit.reporting.analyses.page import AnalysisPage, FigurePaths
from needlefit.reporting.document import Block
from needlefit.reporting.figures.plan import draw_misses, draw_plane
from needlefit.reporting.labels import PLAN_NAMES
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.schemas.planning import PlanRecord
from needlefit.validation.analyses.planning.plan import EXPECTED, TARGET, at_bounds, reaches
from needlefit.validation.analyses.runner import AnalysisResult


def summarize(result: AnalysisResult) -> list[str]:
    """Return sentences: the plan, its expected miss, and the misses of the alternatives."""
    rows = {str(row["plan"]): row for row in to_records(result.frames["plans"])}
    ours = rows[EXPECTED]
    side = "+" if ours["bevel_side"] > 0 else "−"
    angle = _format_signed(ours["angle_deg"])
    direction = f"turned by {angle}°, {ours['depth_mm']:.1f} mm deep, bevel toward {side}y"
    misses = {
        str(row["plan"]): f"{format_mm(row['median_mm'])} and {format_mm(row['miss_95_mm'])} mm"
        for row in rows.values()
    }
    others = "; ".join(
        f"{PLAN_NAMES[name]}, {misses_of_plan}{_describe_bounds(result, rows[name])}"
        for name, misses_of_plan in misses.items()
        if name != EXPECTED
    )
    return [
        f"{_describe_aim(result, ours)}: enter at y = {_format_signed(ours['offset_mm'])} mm, {direction}"
        f"{_describe_bounds(result, ours)}.",
        f"Tried on {ours['draws']} fresh draws, half and 95 % of the needles miss by at most "
        f"{misses[EXPECTED]}. {_describe_exceedances(result)}",
        f"Other plans: {others}.",
    ]


def _describe_aim(result: AnalysisResult, ours: Row) -> str:
    """Return the target of the plan, or the reason why there is no plan."""
    (x, y), limit = _record(result).target_mm, max(_record(result).tolerances_mm)
    target = f"x = {x:g}, y = {y:g} mm"
    if reaches(ours["median_mm"], limit):
        return f"To bring the tip to {target}"
    return f"No plan within these bounds reaches {target}, to {limit:g} mm. The one that misses least"


def _describe_bounds(result: AnalysisResult, row: Row) -> str:
    """Return which values of a plan stand at a bound of the study file."""
    bounded_names = at_bounds(_record(result).entry_plane, row)
    return f" (at a bound of the study: {', '.join(bounded_names)})" if bounded_names else ""


def _describe_exceedances(result: AnalysisResult) -> str:
    ours = result.frames["exceedances"]
    statements = []
    for row in to_records(ours[ours["plan"] == EXPECTED]):
        missed = f"miss by more than {row['limit_mm']:g} mm"
        statements.append(
            f"{_format_share(row['share'])} {missed if row['object'] == TARGET else 'touch ' + row['object']}"
        )
    return f"{', '.join(statements)}."


def lay_out_tables(result: AnalysisResult) -> list[TableLayout]:
    """Return the plans with their misses, and how often they miss by more than the tolerance."""
    plans, exceedances = to_records(result.frames["plans"]), result.frames["exceedances"]
    head = (
        text_column("Plan", wide=True),
        TableColumn("Offset", "mm"),
        TableColumn("Angle", "°"),
        TableColumn("Depth", "mm"),
    )
    ends = (
        TableColumn("Bevel"),
        TableColumn("Half miss by", "mm"),
        TableColumn("95 % by", "mm"),
        TableColumn("rms", "mm"),
    )
    columns = (*head, *ends, TableColumn("Bias x, y", "mm"), TableColumn("Spread", "mm"))
    entry_plane = _record(result).entry_plane
    cells = tuple(_plan_cells(row, at_bounds(entry_plane, row)) for row in plans)
    note = (
        "Misses of fresh draws of the parameters, with errors of entry, depth and layers. Bias: the mean tip "
        "less the target. Spread: root mean square distance from the mean tip."
    )
    caption = "The plans, and by how much they miss."
    marked = any(at_bounds(entry_plane, row) for row in plans)
    notes = (note, *(("* At a bound of the study file.",) if marked else ()))
    table = TableLayout("plans", caption, columns, cells, strong=(0,), notes=notes)
    limits = exceedances[["object", "limit_mm"]].drop_duplicates().itertuples(index=False)
    heads = [
        f"misses by > {limit:g} mm" if object_name == TARGET else f"touches {object_name}"
        for object_name, limit in limits
    ]
    rows = tuple(
        (
            PLAN_NAMES[name],
            *(_share_cell(row) for row in to_records(exceedances[exceedances["plan"] == name])),
        )
        for name in dict.fromkeys(str(row["plan"]) for row in plans)
    )
    shares = (text_column("Plan", wide=True), *(TableColumn(one, "%") for one in heads))
    caption = "How often the needle misses by more, or touches what it should not."
    note = "In brackets the 95 % interval of the share (Wilson)."
    return [table, TableLayout("exceedances", caption, shares, rows, strong=(0,), notes=(note,))]


def _plan_cells(row: Row, bounded: Collection[str]) -> tuple[str, ...]:
    """Return the cells of a plan; values at a bound have a star."""
    values = {"offset": row["offset_mm"], "angle": row["angle_deg"], "depth": row["depth_mm"]}
    aim = (f"{_format_signed(value)}{'*' if name in bounded else ''}" for name, value in values.items())
    bias = f"{_format_signed(row['bias_x_mm'], 2)}, {_format_signed(row['bias_y_mm'], 2)}"
    misses = (format_mm(row[name]) for name in ("median_mm", "miss_95_mm", "rms_mm"))
    side = "+y" if row["bevel_side"] > 0 else "−y"
    return (PLAN_NAMES[str(row["plan"])], *aim, side, *misses, bias, format_mm(row["spread_mm"]))


def draw_figures(result: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the plan in its plane, and the misses of all plans."""
    return {
        "plane": draw_plane(result, folder / "plane.pdf"),
        "within": draw_misses(result, folder / "within.pdf"),
    }


def compose_sections(result: AnalysisResult, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the drawn plan, tables, misses, and the basis of the numbers."""
    captions = {
        "plane": "The plan in its plane: the needle of the mean parameters (thick), those of fresh draws "
        "(thin), and method plans (dashed); right, where all of its needles end. Numbers name the layers.",
        "within": "Share of needles that miss by at most so much; dashed lines are the tolerances.",
    }
    tables = [document.table(table, result.synthetic) for table in lay_out_tables(result)]
    drawn = [document.figure(path, captions[name], result.synthetic) for name, path in figures.items()]
    behind = [document.text(_describe_search(result, row)) for row in to_records(result.frames["posterior"])]
    return [document.heading("The plan"), *drawn, *tables, document.heading("How"), *behind]


def _describe_search(result: AnalysisResult, now: Row) -> str:
    entry_plane = _record(result).entry_plane
    made = f"{now['insertions']} insertion{'s' if now['insertions'] > 1 else ''}"
    source = "sampled" if now["sampled"] else f"importance-weighted, Pareto k {now['pareto_k']:.2f}"
    ranges = {"offset": entry_plane.offset_mm, "angle": entry_plane.angle_deg, "depth": entry_plane.depth_mm}
    units = {"offset": " mm", "angle": "°", "depth": " mm"}
    within = ", ".join(
        f"{name} {_format_signed(low, 0)} to {_format_signed(high, 0)}{units[name]}"
        for name, (low, high) in ranges.items()
    )
    return (
        f"The plan minimises the mean squared miss over draws of the posterior of {made} ({source}), always "
        "the same draws with the same errors of entry, depth and layers; a penalty keeps it away from "
        f"obstacles. Searched: {within}, both sides of the bevel, from several straight aims. Where "
        "parameters are taken for certain many plans hit: the one found first is shown. Needles that go "
        "elsewhere because the model is wrong are not in these misses."
    )


def _record(result: AnalysisResult) -> PlanRecord:
    assert isinstance(result.record, PlanRecord)
    return result.record


def _format_signed(value: float | None, digits: int = 1) -> str:
    return format_mm(value, digits).replace("-", "−")


def _format_share(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _share_cell(row: Row) -> str:
    if row["share"] is None:
        return "–"
    return f"{100 * row['share']:.0f} ({100 * row['low']:.0f}–{100 * row['high']:.0f})"


PAGE = AnalysisPage(summarize, lay_out_tables, draw_figures, compose_sections)
