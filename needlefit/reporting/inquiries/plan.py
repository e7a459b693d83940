"""What is told of a plan: how it would go, and by how much it and its rivals would miss."""

from collections.abc import Collection
from pathlib import Path

from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.plan import draw_misses, draw_plane
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import PLAN_NAMES
from needlefit.reporting.numbers import fixed
from needlefit.reporting.tables import Row, records
from needlefit.schemas.planning import PlanRecord
from needlefit.validation.analyses.planning.plan import EXPECTED, TARGET, at_bounds, reaches
from needlefit.validation.analyses.runner import AnalysisResult


def said(answer: AnalysisResult) -> list[str]:
    """Return the plan, by how much it would miss, and what the others would."""
    rows = {str(row["plan"]): row for row in records(answer.frames["plans"])}
    ours = rows[EXPECTED]
    side = "+" if ours["bevel_side"] > 0 else "−"
    way = f"turned by {_signed(ours['angle_deg'])}°, {ours['depth_mm']:.1f} mm deep, bevel toward {side}y"
    misses = {
        str(row["plan"]): f"{fixed(row['median_mm'])} and {fixed(row['miss_95_mm'])} mm"
        for row in rows.values()
    }
    others = "; ".join(
        f"{PLAN_NAMES[name]}, {both}{_bounded(answer, rows[name])}"
        for name, both in misses.items()
        if name != EXPECTED
    )
    return [
        f"{_aim_said(answer, ours)}: enter at y = {_signed(ours['offset_mm'])} mm, {way}"
        f"{_bounded(answer, ours)}.",
        f"Tried on {ours['draws']} fresh draws, half and 95 % of the needles miss by at most "
        f"{misses[EXPECTED]}. {_beyond_said(answer)}",
        f"Other plans: {others}.",
    ]


def _aim_said(answer: AnalysisResult, ours: Row) -> str:
    """Return what the plan is for, or that there is none, and what stands in its place."""
    (x, y), limit = _record(answer).target_mm, max(_record(answer).tolerances_mm)
    target = f"x = {x:g}, y = {y:g} mm"
    if reaches(ours["median_mm"], limit):
        return f"To bring the tip to {target}"
    return f"No plan within these bounds reaches {target}, to {limit:g} mm. The one that misses least"


def _bounded(answer: AnalysisResult, row: Row) -> str:
    """Return which values of a plan stand at a bound of the study file."""
    held = at_bounds(_record(answer).entry_plane, row)
    return f" (at a bound of the study: {', '.join(held)})" if held else ""


def _beyond_said(answer: AnalysisResult) -> str:
    ours = answer.frames["exceedances"]
    said_of = []
    for row in records(ours[ours["plan"] == EXPECTED]):
        missed = f"miss by more than {row['limit_mm']:g} mm"
        said_of.append(
            f"{_percent(row['share'])} {missed if row['object'] == TARGET else 'touch ' + row['object']}"
        )
    return f"{', '.join(said_of)}."


def layouts(answer: AnalysisResult) -> list[Display]:
    """Return the plans with their misses, and how often they miss by more than is allowed."""
    plans, beyond = records(answer.frames["plans"]), answer.frames["exceedances"]
    head = (text("Plan", wide=True), Column("Offset", "mm"), Column("Angle", "°"), Column("Depth", "mm"))
    ends = (Column("Bevel"), Column("Half miss by", "mm"), Column("95 % by", "mm"), Column("rms", "mm"))
    columns = (*head, *ends, Column("Bias x, y", "mm"), Column("Spread", "mm"))
    entry_plane = _record(answer).entry_plane
    cells = tuple(_cells(row, at_bounds(entry_plane, row)) for row in plans)
    note = (
        "Misses of fresh draws of the parameters, with errors of entry, depth and layers. Bias: the mean tip "
        "less the target. Spread: root mean square distance from the mean tip."
    )
    caption = "The plans, and by how much they miss."
    marked = any(at_bounds(entry_plane, row) for row in plans)
    notes = (note, *(("* At a bound of the study file.",) if marked else ()))
    table = Display("plans", caption, columns, cells, strong=(0,), notes=notes)
    limits = beyond[["object", "limit_mm"]].drop_duplicates().itertuples(index=False)
    heads = [f"misses by > {limit:g} mm" if what == TARGET else f"touches {what}" for what, limit in limits]
    rows = tuple(
        (PLAN_NAMES[name], *(_share(row) for row in records(beyond[beyond["plan"] == name])))
        for name in dict.fromkeys(str(row["plan"]) for row in plans)
    )
    shares = (text("Plan", wide=True), *(Column(one, "%") for one in heads))
    caption = "How often the needle misses by more, or touches what it should not."
    note = "In brackets the 95 % interval of the share (Wilson)."
    return [table, Display("exceedances", caption, shares, rows, strong=(0,), notes=(note,))]


def _cells(row: Row, bounded: Collection[str]) -> tuple[str, ...]:
    """Return the cells of a plan; values at a bound have a star."""
    values = {"offset": row["offset_mm"], "angle": row["angle_deg"], "depth": row["depth_mm"]}
    aim = (f"{_signed(value)}{'*' if name in bounded else ''}" for name, value in values.items())
    bias = f"{_signed(row['bias_x_mm'], 2)}, {_signed(row['bias_y_mm'], 2)}"
    misses = (fixed(row[name]) for name in ("median_mm", "miss_95_mm", "rms_mm"))
    side = "+y" if row["bevel_side"] > 0 else "−y"
    return (PLAN_NAMES[str(row["plan"])], *aim, side, *misses, bias, fixed(row["spread_mm"]))


def draw_all(answer: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the plan in its plane, and how far the needles of all plans miss."""
    return {
        "plane": draw_plane(answer, folder / "plane.pdf"),
        "within": draw_misses(answer, folder / "within.pdf"),
    }


def story(answer: AnalysisResult, figures: Figures) -> list[Block]:
    """Return the plan drawn, tables and misses, and what is behind them."""
    captions = {
        "plane": "The plan in its plane: the needle of the mean parameters (thick), those of fresh draws "
        "(thin), and method plans (dashed); right, where all of its needles end. Numbers name the layers.",
        "within": "Share of needles that miss by at most so much; dashed lines are the tolerances.",
    }
    tables = [document.table(table, answer.synthetic) for table in layouts(answer)]
    drawn = [document.figure(path, captions[name], answer.synthetic) for name, path in figures.items()]
    behind = [document.text(_behind(answer, row)) for row in records(answer.frames["posterior"])]
    return [document.heading("The plan"), *drawn, *tables, document.heading("How"), *behind]


def _behind(answer: AnalysisResult, now: Row) -> str:
    entry_plane = _record(answer).entry_plane
    made = f"{now['insertions']} insertion{'s' if now['insertions'] > 1 else ''}"
    source = "sampled" if now["sampled"] else f"weighed, Pareto k {now['pareto_k']:.2f}"
    ranges = {"offset": entry_plane.offset_mm, "angle": entry_plane.angle_deg, "depth": entry_plane.depth_mm}
    units = {"offset": " mm", "angle": "°", "depth": " mm"}
    within = ", ".join(
        f"{name} {_signed(low, 0)} to {_signed(high, 0)}{units[name]}" for name, (low, high) in ranges.items()
    )
    return (
        f"The plan minimises the mean squared miss over draws of the posterior of {made} ({source}), always "
        "the same draws with the same errors of entry, depth and layers; a penalty keeps it away from "
        f"obstacles. Searched: {within}, both sides of the bevel, from several straight aims. Where "
        "parameters are taken for certain many plans hit: the one found first is shown. Needles that go "
        "elsewhere because the model is wrong are not in these misses."
    )


def _record(answer: AnalysisResult) -> PlanRecord:
    assert isinstance(answer.record, PlanRecord)
    return answer.record


def _signed(value: float | None, digits: int = 1) -> str:
    return fixed(value, digits).replace("-", "−")


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _share(row: Row) -> str:
    if row["share"] is None:
        return "–"
    return f"{100 * row['share']:.0f} ({100 * row['low']:.0f}–{100 * row['high']:.0f})"


PAGE = Page(said, layouts, draw_all, story)
