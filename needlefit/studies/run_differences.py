"""Find in what two runs differ, and whether it matters.

Runs are compared by what they wrote for readers (`run.json` and CSVs), so that a run may be compared with
committed evidence too. A difference matters where it could change what is concluded: a parameter that moved
by more than `MIN_SHIFT_SD` of its standard deviation, errors on the same insertions that changed visibly and
by more than two standard errors, a verdict, what converged.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.errors import DataError
from needlefit.project.folders import require_unchanged
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.json_values import to_json_values
from needlefit.reporting.number_format import format_number
from needlefit.reporting.table import Table, TableLayout
from needlefit.studies.csv_tables import ANY_COLUMNS, TableSchema, read_table
from needlefit.studies.kind import find_kind
from needlefit.studies.store import read_run

MIN_SHIFT_SD = 0.5
"""Part of its standard deviation by which a parameter that is determined may move and stay what it was."""

VISIBLE_ERROR_MM = 0.005  #: mm: a mean error that changes by less is printed alike
VISIBLE_ERROR_PERCENT = 0.05  #: the same of a relative error
CRPS_NOISE_FRACTION = 0.1  #: part of a CRPS that changes with the draws it is computed from

ROUNDING_FRACTION = 0.02
"""Part of `MIN_SHIFT_SD` or `VISIBLE_ERROR_MM` under which a change is slight: of rounding, or of a search's
tolerance."""

SIGNIFICANT_SE = 2.0  #: standard errors from which on a mean difference is taken for one


@dataclass(frozen=True)
class Difference:
    """One difference of run B from run A."""

    what: str
    where: str  #: which key, parameter or insertions
    before: object  #: in A and in B, as JSON knows values; None where one of them has none
    after: object  #: in A and in B, as JSON knows values; None where one of them has none
    matters: bool | None  #: none for inputs: they are why results differ, and no result
    why: str  #: in words
    slight: bool = False  #: whether it is of the size of rounding


def compare_means(
    where: str, rows: pd.DataFrame, column: str, visible: float | None = None, unit: str = "mm"
) -> Iterator[Difference]:
    """Yield the change of the mean of a column, over the rows that both runs have.

    Changes up to `visible` do not matter; None: up to what is printed alike.

    Where only one of them has a finite value, as of a simulation that did not converge, that is a difference.
    """
    pairs = rows[[f"{column}_a", f"{column}_b"]].to_numpy(dtype=np.float64)
    there = np.isfinite(pairs)
    if np.any(there[:, 0] != there[:, 1]):
        before, after = (int(count) for count in there.sum(axis=0))
        yield Difference("state", where, before, after, True, "values that are finite, of the same rows")
    pairs = pairs[there.all(axis=1)]
    gap = pairs[:, 1] - pairs[:, 0]
    if not np.any(gap):
        return
    mean, error = float(np.mean(gap)), math.nan
    words = f"{mean:+z.4f} {unit} on 1 insertion"
    if gap.size > 1:
        error = float(np.std(gap, ddof=1) / math.sqrt(gap.size))
        words = f"{mean:+z.4f} ± {error:.4f} {unit} on {gap.size} insertions"
    printed = VISIBLE_ERROR_MM if unit == "mm" else VISIBLE_ERROR_PERCENT
    matters = (
        abs(mean) > (printed if visible is None else visible) and not abs(mean) <= SIGNIFICANT_SE * error
    )
    slight = float(np.max(np.abs(gap))) < ROUNDING_FRACTION * printed
    one, two = (float(value) for value in pairs.mean(axis=0))
    yield Difference("error", where, one, two, matters, words.replace("-", "−"), slight)


MIN_SD_CHANGE = 0.1  #: part by which a standard deviation may change and say the same


def compare_sizes(what: str, where: str, before: float, after: float, words: str) -> Iterator[Difference]:
    """Yield the change of a width or a standard deviation; nothing where a run has none."""
    if before != after and before > 0 and after > 0:
        change = abs(math.log(after / before))
        matters, slight = change > MIN_SD_CHANGE, change < ROUNDING_FRACTION * MIN_SD_CHANGE
        yield Difference(what, where, before, after, matters, f"{after / before:.3g} {words}", slight)


def compare_estimates(
    what: str, where: str, before: float, after: float, part: float, *, determined: bool = True
) -> Difference:
    """Return the change of an estimate by a `part` of its standard deviation."""
    why = f"{part:.2g} of its standard deviation" + ("" if determined else ", not determined")
    matters, slight = determined and part > MIN_SHIFT_SD, part < ROUNDING_FRACTION * MIN_SHIFT_SD
    return Difference(what, where, before, after, matters, why, slight)


@dataclass(frozen=True)
class TableComparison:
    """How a kind of study compares one of its tables: the columns that are read, and the function.

    `compare` takes the tables of run A and of run B.
    """

    schema: TableSchema
    compare: Callable[[pd.DataFrame, pd.DataFrame], Iterator[Difference]]


_STATES = (
    "interrupted",
    "budget_limited",
    "posteriors",
    "passes",
    "not_calibrated",
    "not_converged",
    "faults",
)
_INPUTS = (
    *("dataset", "medium", "recipe", "rules", "study", "fit", "folds", "hand_tuned", "versions"),
    *("source_revision", "datasets", "parts", "scene", "fits", "control", "sampled", "replicates"),
)


def compare_runs(before: Path, after: Path, unverified: bool = False) -> list[Difference]:
    """Return all differences of run folder `after` from `before`: inputs, states, parameters, errors.

    Raises DataError if a `run.json` is missing, a file is damaged or (unless `unverified`) does not agree
    with its manifest, or the runs are of different kinds.
    """
    with convert_stored_errors(f"{before} or {after}"):
        faults = [", ".join(require_unchanged(folder, unverified)) or None for folder in (before, after)]
        named = "files that do not agree with the manifest"
        marks = [Difference("state", named, faults[0], faults[1], True, "")] if any(faults) else []
        one, two = read_run(before), read_run(after)
        for folder, run in ((before, one), (after, two)):
            if not run.get("kind"):
                raise DataError(
                    "states no kind of study",
                    where=str(folder / "run.json"),
                    expected="a run of one study",
                    fix="name the folder of one study, or run it again",
                )
        kinds = [str(run["kind"]) for run in (one, two)]
        if kinds[0] != kinds[1]:
            raise DataError(
                f"is of kind {kinds[1]}, and {before} of kind {kinds[0]}: they answer different questions",
                where=str(after),
                expected=f"a run of kind {kinds[0]}",
                fix="compare runs of the same command",
            )
        pairs = {key: (one.get(key), two.get(key)) for key in _STATES}
        return [
            *marks,
            *compare_leaves(*({key: run[key] for key in _INPUTS if key in run} for run in (one, two))),
            *(
                Difference("state", key, *pair, key != "posteriors", "")
                for key, pair in pairs.items()
                if pair[0] != pair[1]
            ),
            *_compare_folders(kinds[0], before, after),
        ]


def _compare_folders(kind: str, before: Path, after: Path) -> Iterator[Difference]:
    """Yield the changes in the tables that both folders hold, as the kind of study compares them."""
    report = find_kind(kind).report
    names = sorted(path.stem for path in before.glob("*.csv") if (after / path.name).is_file())
    for name in names:
        if name in report.comparisons:
            special = report.comparisons[name]
            yield from special.compare(
                *(read_table(folder / f"{name}.csv", special.schema) for folder in (before, after))
            )
        elif not report.compares_only_these:
            one, two = (read_table(folder / f"{name}.csv", ANY_COLUMNS) for folder in (before, after))
            yield from compare_tables(name, one, two)


def compare_leaves(before: object, after: object) -> Iterator[Difference]:
    """Yield every value of nested mappings that differs, by its path; a list is one value."""
    every = [dict(_iterate_leaves(value)) for value in (before, after)]
    for key in dict.fromkeys([*every[0], *every[1]]):
        one, two = every[0].get(key), every[1].get(key)
        if one != two:
            yield Difference("input", key, one, two, None, "")


def _iterate_leaves(value: object, path: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(value, Mapping) and (value or not path):
        for key, inner in value.items():
            yield from _iterate_leaves(inner, f"{path}.{key}" if path else str(key))
    else:
        yield path, value


MIN_RELATIVE_CHANGE = 0.1  #: part by which a number that is no length may change and say the same


def compare_tables(name: str, before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    numbers = [str(one) for one in before if is_number(before, one) and is_number(after, one)]
    keys = [str(one) for one in before if one in after and str(one) not in numbers]
    both = _number_repeats(before, keys).merge(
        _number_repeats(after, keys),
        on=[*keys, _REPEAT],
        how="outer",
        suffixes=("_a", "_b"),
        indicator="in",
        sort=False,
    )
    alone = both[both["in"] != "both"]
    if len(alone):
        first = ", ".join(filter(None, (str(alone.iloc[0][key]) for key in keys)))
        why = f"{len(alone)} rows are in one run only, the first of them: {first}"
        yield Difference("state", f"rows of {name}", len(before), len(after), True, why)
    same = both[both["in"] == "both"].reset_index(drop=True)
    for column in numbers:
        where = f"{name}, {column}"
        if column.endswith("_mm") and "insertion" in keys:
            yield from compare_means(where, same, column)
        else:
            yield from _find_greatest_change(where, same, column, keys)


_REPEAT = "__repeat"


def _number_repeats(frame: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Return a frame whose rows are identified by their words, and by their order where these are alike.

    A missing word is empty: a missing value would match every other one.
    """
    words = frame.assign(
        **{key: frame[key].astype(object).where(frame[key].notna(), "").astype(str) for key in keys}
    )
    return words.assign(
        **{_REPEAT: words.groupby(keys, sort=False).cumcount() if keys else range(len(frame))}
    )


def is_number(frame: pd.DataFrame, column: object) -> bool:
    """Return whether a table has a column of numbers with a fraction."""
    return column in frame and pd.api.types.is_float_dtype(frame[column])


def _find_greatest_change(
    where: str, rows: pd.DataFrame, column: str, keys: list[str]
) -> Iterator[Difference]:
    """Yield the greatest change of a number: of a length in mm, of others beside the size of their column."""
    before, after = (rows[f"{column}_{run}"].to_numpy(dtype=np.float64) for run in "ab")
    gap = np.abs(after - before)
    if not np.any(gap > 0):
        return
    row = int(np.nanargmax(gap))
    at = ", ".join(filter(None, (str(rows.loc[row, key]) for key in keys)))
    if column.endswith("_mm"):
        part, why = float(gap[row]) / VISIBLE_ERROR_MM, f"at most {gap[row]:.3g} mm"
        matters, slight = part > 1, part < ROUNDING_FRACTION
    else:
        size = float(np.nanmax(np.abs(before)))
        part = float(gap[row]) / size if size else np.inf
        why = f"at most {part:.2g} of the largest of its column"
        matters, slight = part > MIN_RELATIVE_CHANGE, part < ROUNDING_FRACTION * MIN_RELATIVE_CHANGE
    why = f"{why}: {at}" if at else why
    yield Difference("parameter", where, float(before[row]), float(after[row]), matters, why, slight)


MAX_CELL_LETTERS = 40  #: characters of a value that a table shows


def summarize_differences(found: Sequence[Difference]) -> str:
    """Return whether any difference matters, and how many there are."""
    results = [one for one in found if one.matters is not None]
    if not found:
        return "No difference."
    inputs = len(found) - len(results)
    because = (
        f"{count_words(inputs, 'input')} {'differs' if inputs == 1 else 'differ'}"
        if inputs
        else "the inputs are the same"
    )
    if not results:
        return f"No result differs; {because}."
    relevant = sum(bool(one.matters) for one in results)
    rounding = sum(one.slight and not one.matters for one in results)
    small = len(results) - relevant - rounding
    parts = [
        f"{count_words(count, 'number')} {'differs' if count == 1 else 'differ'} {how}"
        for count, how in ((small, "too little to matter"), (rounding, "by rounding"))
        if count
    ]
    head = f"{count_words(relevant, 'relevant change')}." if relevant else "No relevant change."
    return f"{head} {'; '.join([*parts, because])}."


def lay_out_differences(found: Sequence[Difference], everything: bool = False) -> TableLayout:
    """Return one row per difference that matters, then the inputs; `everything`: also the other changes."""
    order = {True: 0, False: 1, None: 2}
    shown = [one for one in found if everything or one.matters or one.matters is None]
    rows = sorted(shown, key=lambda one: order[one.matters])
    cells = [
        {
            **{"what": one.what, "found_at": one.where, "changed_by": one.why, "rank": order[one.matters]},
            "before": _format_value(one.before),
            "after": _format_value(one.after),
            "matters": _MARKS[one.matters],
            "strong": bool(one.matters),
        }
        for one in rows
    ]
    columns = ("what", "found_at", "before", "after", "changed_by", *(("matters",) if everything else ()))
    left = len(found) - len(rows)
    note = (
        "A change matters if an identifiable parameter moved by more than half its standard deviation, if a "
        "mean error changed by more than 0.005 mm (a CRPS by more than 10 %) and by more than two standard "
        "errors on the same insertions, if the width of an interval changed by more than 10 %, or if a "
        "verdict (such as that an interval covers too few insertions) or a state changed."
    )
    hidden = (f"Not shown: {left} not relevant (`--all` prints them).",)
    notes = (*((note,) if everything or any(one.matters for one in rows) else ()), *(hidden if left else ()))
    caption = "Changes from A (first run) to B (second run)."
    return Table(
        "differences", cells, columns, groups=("rank",), strong="strong", caption=caption, notes=notes
    ).lay_out()


def differences_to_json(found: Sequence[Difference]) -> list[object]:
    return [to_json_values(asdict(one)) for one in found]


_MARKS = {True: "yes", False: "no", None: ""}


def count_words(count: int, noun: str) -> str:
    """Return "1 key", "2 keys"."""
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _format_value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return format_number(value)
    shown = str(value)
    return shown if len(shown) <= MAX_CELL_LETTERS else shown[: MAX_CELL_LETTERS - 1] + "…"
