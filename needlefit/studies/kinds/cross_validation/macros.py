"""The numbers of a run as LaTeX macros."""

from collections.abc import Iterator, Sequence

from needlefit.metrics import list_metrics
from needlefit.reporting import latex
from needlefit.reporting.columns import DIGITS, METRIC_FORMAT, find_column, format_value
from needlefit.reporting.interval_text import choose_interval_unit, typeset_interval
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.identification_tables import lay_out_identification
from needlefit.studies.kinds.cross_validation import detail_tables, score_tables
from needlefit.studies.kinds.cross_validation.parameter_table import arrange_parameters, tabulate_parameters
from needlefit.studies.kinds.cross_validation.posterior import lay_out_posterior
from needlefit.studies.kinds.cross_validation.sentences import find_scored_role
from needlefit.studies.kinds.cross_validation.tables import BY_LAYERS, BY_MEDIA, list_held_out_groups
from needlefit.studies.run import Run


def format_macros(results: Sequence[Run]) -> str:
    """Return a LaTeX file of macros of every printed number, by readable keys.

    A key is `<run>-<medium>-<layers>-<error>`, with `floor-` or `paper-` before the error for what stands
    beside it or `-over-floor` after it for the multiple of its noise floor; `<run>-<parameter>`, with `-low`,
    `-high` and `-interval` of its 95 % interval (`-interval` alone where that is "not determined"), all in
    the unit of the tables, `-unit`; or that of a cell of a table (`format_table_macros`).
    """
    return latex.format_macros(number for one in results for number in _list_numbers(one))


def _list_numbers(results: Run) -> Iterator[tuple[str, str]]:
    yield from _list_errors(results)
    yield from _list_parameters(results)
    yield from latex.list_cells(results.name, tuple(list_tables(results)))


def list_tables(results: Run) -> Iterator[TableLayout]:
    """Yield every table that a run's report prints."""
    role = find_scored_role(results)
    yield score_tables.lay_out_design([results])
    yield score_tables.lay_out_validation([results])
    yield from (score_tables.lay_out_tuning([results], grouping) for grouping in (BY_LAYERS, BY_MEDIA))
    if len(results.frames["predictive"]):
        yield score_tables.lay_out_coverage(results)
    yield detail_tables.lay_out_baselines([results], role)
    yield detail_tables.lay_out_parameters([results])
    yield detail_tables.lay_out_directions(results)
    if len(results.frames["identification"]):
        yield lay_out_identification(results.frames["identification"])
    if results.posteriors:
        yield lay_out_posterior(results)
    yield detail_tables.lay_out_insertions(results, role)


def _list_errors(results: Run) -> Iterator[tuple[str, str]]:
    for group in list_held_out_groups(results):
        head = group.head
        begin = f"{results.name}-{head['medium']}-{head['layers']}"
        yield f"{begin}-n", str(head["insertions"])
        for metric in list_metrics():
            row = {"metric": metric.name, DIGITS: 3 if head["comparison"] == "aligned" else 2}
            for key, column in (("", "value"), ("floor-", "floor"), ("paper-", "paper")):
                value = group.get(metric.name, column)
                if value is not None or not key:
                    yield f"{begin}-{key}{metric.macro_name}", format_value(METRIC_FORMAT, value, row)
            if (times := group.over_floor(metric.name)) is not None:
                words = find_column("over_floor").format_cell({"over_floor": times})
                yield f"{begin}-{metric.macro_name}-over-floor", words


def _list_parameters(results: Run) -> Iterator[tuple[str, str]]:
    table = arrange_parameters(tabulate_parameters(results))
    several = len({row["fold"] for row in table}) > 1
    for row in table:
        name = str(row["parameter"]).removesuffix("_pa").removesuffix("_mm").replace("_", "-")
        where = f"-{row['fold']}" if several else ""
        key = f"{results.name}{where}-{name}"
        label, scale = choose_interval_unit(row, row["value_used"])
        yield key, detail_tables.format_in_unit(row["fitted"], scale)
        if unit := label.partition(" (")[2].rstrip(")"):
            yield f"{key}-unit", unit
        if interval := typeset_interval(row, scale):
            yield f"{key}-interval", interval
            low, to, high = interval.partition(" to ")
            yield from ((f"{key}-low", low), (f"{key}-high", high)) if to else ()
