"""Report of a plan: expected misses of the plan and of the alternative plans."""

from pathlib import Path

from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.labels import PLAN_NAMES
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.plan.figures import draw_misses, draw_plane
from needlefit.studies.kinds.plan.run import EXPECTED, TARGET, at_bounds, reaches
from needlefit.studies.kinds.plan.schema import PlanRecord
from needlefit.studies.new_specimens import describe_spread
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.verdict import Status, headline_fault


def summarize(result: Run) -> list[str]:
    """Return sentences: the plan with its expected miss, how often it misses by more, the alternatives."""
    rows = {str(row["method"]): row for row in to_records(result.frames["plans"])}
    ours = rows[EXPECTED]
    if not _is_certified(result):
        why = "the draws of the parameters are not reliable"
        return [f"No plan is a result: {why}. The search ended at: {_describe_entry(result, ours)}."]
    others = "; ".join(
        f"{PLAN_NAMES[name]}, {_describe_misses(row)}{_describe_bounds(result, row)}"
        for name, row in rows.items()
        if name != EXPECTED
    )
    return [
        f"{_describe_aim(result, ours)}; {_describe_misses(ours)}.",
        f"On {ours['draws']} posterior draws {_describe_exceedances(result)}",
        f"Other plans, median and 95th percentile of the miss: {others}.",
    ]


def rate(result: Run) -> Status:
    """Return "warn" if no plan reaches the target, or the plan lies at a bound of the study."""
    (ours,) = (row for row in to_records(result.frames["plans"]) if row["method"] == EXPECTED)
    record = _record(result)
    good = reaches(ours["median_mm"], max(record.tolerances_mm)) and not at_bounds(record.entry_plane, ours)
    return "pass" if good else "warn"


def _describe_aim(result: Run, ours: Row) -> str:
    """Return the plan, after whether it reaches the target."""
    (x, y), limit = _record(result).target_mm, max(_record(result).tolerances_mm)
    plan = _describe_entry(result, ours)
    if reaches(ours["median_mm"], limit):
        return f"Plan: {plan}"
    return f"No plan comes within {limit:g} mm of the target ({x:g}, {y:g} mm); the best is: {plan}"


def _is_certified(result: Run) -> bool:
    return not any(result.frames["posterior"]["note"].fillna(""))


def _describe_entry(result: Run, ours: Row) -> str:
    side = "+" if ours["bevel_side"] > 0 else "−"
    return (
        f"enter at y = {_format_signed(ours['offset_mm'])} mm, angle {_format_signed(ours['angle_deg'])}°, "
        f"depth {ours['depth_mm']:.1f} mm, bevel toward {side}y{_describe_bounds(result, ours)}"
    )


def _describe_misses(row: Row) -> str:
    return f"miss {format_mm(row['median_mm'])} mm (95th percentile {format_mm(row['miss_95_mm'])} mm)"


def _describe_bounds(result: Run, row: Row) -> str:
    """Return which values of a plan lie at a bound of the study file."""
    bounded_names = at_bounds(_record(result).entry_plane, row)
    return f" (at a bound of the study: {', '.join(bounded_names)})" if bounded_names else ""


def _describe_exceedances(result: Run) -> str:
    ours = result.frames["exceedances"]
    statements = []
    for row in to_records(ours[ours["method"] == EXPECTED]):
        missed = f"miss by more than {row['limit_mm']:g} mm"
        statements.append(
            f"{_format_share(row['share'])} {missed if row['object'] == TARGET else 'touch ' + row['object']}"
        )
    return f"{', '.join(statements)}."


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return the plans with their misses, and how often they miss by more than the tolerance."""
    plans, entry_plane = result.frames["plans"], _record(result).entry_plane
    rows = [
        {
            **row,
            **{f"{name}_mark": "*" if name in at_bounds(entry_plane, row) else "" for name in _AIMS},
            "plan": PLAN_NAMES[str(row["method"])],
            "bevel_side": "+y" if row["bevel_side"] > 0 else "−y",
        }
        for row in to_records(plans)
    ]
    columns = (
        *("plan", *(f"aimed_{name}" for name in _AIMS), "bevel_side", "half_miss", "miss_95", "rms_mm"),
        *("bias", "miss_spread"),
    )
    note = (
        "Misses over new posterior draws, with errors of entry, depth and layers. Bias: mean tip minus "
        "target. Spread: root mean square distance from the mean tip."
    )
    marked = any(at_bounds(entry_plane, row) for row in to_records(plans))
    notes = (note,)
    explained = " (*: at a bound of the study file)" if marked else ""
    caption = f"Plans and the distance by which their needles miss the target{explained}."
    table = Table("plans", caption, rows, columns, strong="first", notes=notes)
    return [table.lay_out(), *([_lay_out_exceedances(result)] if _is_certified(result) else [])]


_AIMS = ("offset", "angle", "depth")


def _lay_out_exceedances(result: Run) -> TableLayout:
    rows = [
        {**row, "plan": PLAN_NAMES[str(row["method"])], "event": _name_event(row)}
        for row in to_records(result.frames["exceedances"])
    ]
    shares = (part("exceedance_share", event=event) for event in dict.fromkeys(row["event"] for row in rows))
    caption = "Share of needles that miss the target by more than a tolerance, or touch an obstacle."
    notes = ("In brackets: 95 % confidence interval of the share (Wilson).",)
    plans = pivot(rows, ["plan"], ["event"])
    return Table("exceedances", caption, plans, ("plan", *shares), strong="first", notes=notes).lay_out()


def _name_event(row: Row) -> str:
    missed = row["object"] == TARGET
    return f"misses by > {row['limit_mm']:g} mm" if missed else f"touches {row['object']}"


def draw_figures(result: Run, folder: Path) -> dict[str, Path]:
    """Draw the plan in its plane, and the misses of all plans."""
    plane = {"plane": draw_plane(result, folder / "plane.pdf")}
    if not len(result.frames["misses"]):
        return plane
    return {**plane, "within": draw_misses(result, folder / "within.pdf")}


def compose_sections(result: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the drawn plan, tables, misses, and the basis of the numbers."""
    captions = {
        "plane": "The plan in its plane: needle of the mean parameters (thick), needles of new posterior "
        "draws (thin), other plans (dashed). Right: all tips of the plan. Numbers are layers.",
        "within": "Share of needles whose miss is below a distance. Dashed: tolerances of the study.",
    }
    if not _is_certified(result):
        captions["plane"] = (
            "The search’s end in its plane: needle of the mean parameters (thick), other plans (dashed). "
            "Numbers are layers. Draws and misses are not drawn: the draws are not reliable."
        )
    tables = [document.table(table) for table in lay_out_tables(result)]
    drawn = [document.figure(path, captions[name]) for name, path in figures.items()]
    behind = [document.text(_describe_search(result, row)) for row in to_records(result.frames["posterior"])]
    return [document.heading("The plan"), *drawn, *tables, document.heading("Method"), *behind]


def _describe_search(result: Run, now: Row) -> str:
    entry_plane = _record(result).entry_plane
    made = f"{now['insertions']} insertion{'s' if now['insertions'] > 1 else ''}"
    source = "sampled" if now["sampled"] else f"importance-weighted, Pareto k {now['pareto_k']:.2f}"
    units = {"offset": " mm", "angle": "°", "depth": " mm"}
    within = ", ".join(
        f"{name} {_format_signed(low, 0)} to {_format_signed(high, 0)}{units[name]}"
        for name, (low, high) in entry_plane.ranges.items()
    )
    return (
        f"The plan minimises the mean squared miss over draws of the posterior of {made} ({source}). All "
        "plans use the same draws, with the same errors of entry, depth and layers. A penalty keeps the "
        f"plan away from obstacles. {_describe_specimen(now)}Search range: {within}, both bevel sides, from "
        "several straight starts. If parameters are taken as certain, many plans hit the target: the first "
        "found is shown. Model error is not included in the misses."
    )


def _describe_specimen(now: Row) -> str:
    """Return what the plan takes its specimen for."""
    if now["specimen_treatment"] == "others":
        return f"The specimen is a new one: {describe_spread(now)}. "
    return "The specimen is one that was fitted to. "


def _record(result: Run) -> PlanRecord:
    assert isinstance(result.record, PlanRecord)
    return result.record


def _format_signed(value: float | None, digits: int = 1) -> str:
    return format_mm(value, digits).replace("-", "−")


def _format_share(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def headline(fault: str) -> str:
    """Return the headline of a fault; a target out of reach is the verdict itself."""
    return "" if fault.startswith("no plan") else headline_fault(fault)


REPORT = StudyReport(summarize, lay_out_tables, draw_figures, compose_sections, rate=rate, headline=headline)
