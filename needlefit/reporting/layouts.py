"""Frames set as tables for print: our rows above the paper's, so that each column reads downwards."""

from collections.abc import Sequence

from needlefit.reporting.display import Column, Display, text, without_empty
from needlefit.reporting.names import medium_name
from needlefit.reporting.numbers import MISSING, fixed, percent
from needlefit.reporting.tables import Row, over_floor, records, study_label, tuning_table, validation_table
from needlefit.validation.results import Results

_SCORES = (
    Column("Median", "mm"),
    Column("IPE", "mm"),
    Column("Max IPE", "mm"),
    Column("TE", "mm"),
    Column("EDP", "%"),
    Column("IPE", "÷ floor"),
    Column("TE", "÷ floor"),
)
_WAYS = {  # what a row means, said under the table where the row stands in it
    "needlefit": "Each cell is the mean over insertions of each one’s value; IPE is mean ± standard "
    "deviation.",
    "by IPE, TE, EDP": "“Needlefit” is the fit of greatest posterior density; “by IPE, TE, EDP” minimises "
    "these errors on the tuning insertions instead, as tuning by hand does.",
    "planned boundaries": "“Planned boundaries” scores the same model with layer depths from the planned "
    "straight path: the measured crossings of a held-out insertion leak its outcome.",
    "pooled": "“Pooled” takes the statistics of all points together; of medians and maxima the noise floor "
    "would then be another.",
    "noise floor": "“Noise floor” is what perfect parameters would still show if measurements err "
    "as the dataset states; “÷ floor”, the error as a multiple of it: about 1 is all that these measurements "
    "can tell. The paper gives no floor of its own.",
}
_OTHERWISE = "‡"
_REREAD = (
    f"{_OTHERWISE} An insertion that ends at a boundary is counted the other way in these rows: the same fit "
    "and the same predictions in other groups."
)
_COUNTED = (
    "“Otherwise” counts the same insertions by the other reading of those that end at a boundary; the paper "
    "uses one reading where it lists them and the other where it divides them among its studies. “Bends” is "
    "the measured deflection of the tip, positive toward the bevel."
)
_ALIGNED = "Errors are after rigid alignment of each shape, whose pose in the world is not known."


def validation_layout(results: Sequence[Results]) -> Display:
    """Return the validation table: per held-out group ours, with planned boundaries, floor, and the paper."""
    table = records(validation_table(*results, both=True))
    heads = (text("Study"), text("Held out"), Column("Layers"), Column("n"), text("Row"))
    ways = [("needlefit", ""), ("planned boundaries", "planned_"), ("pooled", "pooled_")]
    ways.insert(1, ("by IPE, TE, EDP", "fitted_metric_"))
    return _stacked(
        Display("validation", "Errors on held-out insertions.", heads, ()),
        [(_group(row, row["validate_medium"], row["validate_layers"]), row) for row in table],
        ways,
    )


def tuning_layout(results: Sequence[Results], by: str) -> Display:
    """Return the in-sample errors `by` "layers" or "media", beside the paper's tuned models."""
    table = [row for row in records(tuning_table(*results, both=True)) if row["grouping"] == by]
    heads = (text("Fit of"), text("Tuned on"), Column("Layers"), Column("n"), text("Row"))
    what = "number of layers" if by == "layers" else "medium"
    return _stacked(
        Display(f"tuning_by_{by}", f"In-sample errors of the tuned models by {what}.", heads, ()),
        [(_group(row, row["medium"], row["layers"]), row) for row in table],
        [("needlefit", ""), ("pooled", "pooled_")],
    )


def design_layout(results: Sequence[Results]) -> Display:
    """Return what tunes and what validates: counts, and the ranges of depth and measured deflection."""
    heads = (text("Study"), text("Role"), text("Medium"), Column("Layers"), Column("Insertions"))
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for one in results:
        breaks += [len(rows)] if rows else []
        for i, row in enumerate(records(one.design)):
            cells = ("tunes" if row["role"] == "tune" else "validates", medium_name(row["medium"]))
            other = "" if row["insertions"] == row["insertions_other"] else str(row["insertions_other"])
            counts = (str(row["layers"]), str(row["insertions"]), other)
            spans = [span(row[f"{what}_min_mm"], row[f"{what}_max_mm"]) for what in ("depth", "deflection")]
            rows.append((str(study_label(one)) if i == 0 else "", *cells, *counts, *spans, one.origin))
    columns = (*heads, Column("Otherwise"), Column("Depth", "mm"), Column("Bends", "mm"), text("Origin"))
    notes = (_COUNTED,) if any(row[5] for row in rows) else ()
    table = Display(
        "design", "What tunes and what validates.", columns, tuple(rows), tuple(breaks), notes=notes
    )
    return without_empty(table)


def span(low: float, high: float) -> str:
    """Return "19.48 to 54.75", or a single number where both are printed alike."""
    ends = [fixed(low).replace("-", "−"), fixed(high).replace("-", "−")]
    return " to ".join(dict.fromkeys(ends))


def _stacked(
    frame: Display, groups: list[tuple[tuple[str, ...], Row]], ways: list[tuple[str, str]]
) -> Display:
    """Return `frame` filled with one block of rows per group; only its first row names the group."""
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    strong: list[int] = []
    caveats: list[str] = []
    same: dict[str, list[str]] = {}
    for head, row in groups:
        breaks += [len(rows)] if rows else []
        strong.append(len(rows))
        for name, cells in _block(row, ways):
            begins = len(rows) == strong[-1]
            origin = "paper, measured" if name == "paper" else str(row["origin"])
            rows.append((*(head if begins else ("",) * len(head)), name, *cells, origin))
        same.setdefault(str(row["comparable"]), []).append(_called(head))
        caveats += _caveats(head, row)
    columns = (*frame.columns, *_SCORES, text("Origin"))
    compared = [f"{'; '.join(heads)}: {sentence}" for sentence, heads in same.items()]
    names = {row[len(head)] for row in rows for head, _ in groups[:1]}
    said = [sentence for way, sentence in _WAYS.items() if way in names]
    said += [_REREAD] if any(row["alternate_count"] for _, row in groups) else []
    said += [_ALIGNED] if any(row["comparison"] == "aligned" for _, row in groups) else []
    caption = frame.caption.removesuffix(".") + (", beside the paper’s." if "paper" in names else ".")
    notes = (" ".join(said), *compared, *caveats) if said else ()
    return Display(frame.name, caption, columns, tuple(rows), tuple(breaks), tuple(strong), notes)


def _block(row: Row, ways: list[tuple[str, str]]) -> list[tuple[str, tuple[str, ...]]]:
    digits = 3 if row.get("comparison") == "aligned" else 2
    told = [way for way in ways if not row["alternate_count"] or way[1] in ("", "pooled_")]
    lines = [(name, _scores(row, prefix, digits)) for name, prefix in told]
    lines += [("noise floor", _scores(row, "floor_", digits)), ("paper", _scores(row, "paper_", 2))]
    return [(name, cells) for name, cells in lines if any(cell != MISSING for cell in cells)]


def _scores(row: Row, prefix: str, digits: int) -> tuple[str, ...]:
    def cell(name: str) -> str:
        return fixed(row.get(f"{prefix}{name}_mm"), digits)

    spread = f" ± {cell('ipe_std')}" if cell("ipe_std") != MISSING else ""
    flag = "†" if prefix != "paper_" and row["edp_flagged"] else ""
    edp = percent(row.get(f"{prefix}edp_percent"))
    edp = edp if edp == MISSING else edp + flag
    known = [] if prefix in ("floor_", "paper_") else ["ipe_mean", "te"]
    ratios = [fixed(over_floor(row, f"{prefix}{name}_mm"), 1) for name in known] or [MISSING, MISSING]
    return (cell("median_err"), cell("ipe_mean") + spread, cell("ipe_max"), cell("te"), edp, *ratios)


def _group(row: Row, medium: str, layers: int | None) -> tuple[str, ...]:
    count = str(layers or "all") + (_OTHERWISE if row["alternate_count"] else "")
    return (str(row["study"]), medium_name(medium), count, str(row["insertions"]))


def _caveats(head: tuple[str, ...], row: Row) -> list[str]:
    said = []
    if row["edp_flagged"]:
        rest = percent(row["edp_unflagged_percent"])
        without = "" if rest == MISSING else f"; without them EDP is {rest} %"
        said.append(
            f"† {_called(head)}: {row['edp_flagged']} of {row['insertions']} deflect less than the noise "
            f"floor, so their EDP means little{without}."
        )
    if row["not_converged"]:
        said.append(
            f"{_called(head)}: {row['not_converged']} of {row['insertions']} simulations did not converge "
            "and are missing from the means."
        )
    return said


def _called(head: tuple[str, ...]) -> str:
    study = f"Study {head[0]}" if head[0].isdigit() else head[0]
    count = head[2].removesuffix(_OTHERWISE)
    layers = "all layers" if count == "all" else "1 layer" if count == "1" else f"{count} layers"
    layers += _OTHERWISE if head[2] != count else ""
    return f"{study}, {head[1]}, {layers}"
