"""Prepare an import: a mapping that is given, or drafted and completed; what it reads; and the plan."""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from needlefit.datasets.importing.assignments import Assignments
from needlefit.datasets.importing.curves import ImportContent, ImportedCurve
from needlefit.datasets.importing.draft import Draft, Open
from needlefit.datasets.importing.draft_files import draft_mapping
from needlefit.datasets.importing.draft_table import COORDINATES, POINTS
from needlefit.datasets.importing.examples import find_examples
from needlefit.datasets.importing.meanings import MEANINGS
from needlefit.datasets.importing.place import ImportPlan, Planner
from needlefit.datasets.importing.read import MappedTable, list_tables, read_curves, read_mapped
from needlefit.datasets.importing.stated import Settler, name_set
from needlefit.datasets.importing.synonyms import list_bare_numbers
from needlefit.errors import ConfigError, DataError
from needlefit.project.toml import check, load, override
from needlefit.project.unit_warnings import DIAMETER_MM
from needlefit.project.units import UNITS_MM
from needlefit.schemas.mapping import MappingRecord

ASSUMED_MM = (20.0, 300.0)  # least and greatest length (mm) of the longest needle where mm are assumed
STATED_MM = (1.0, 2000.0)  # least and greatest length (mm) of the longest needle by a stated unit
LENGTHS_MM = {  # least and greatest length (mm) that is believed without a unit of its own
    "diameter": DIAMETER_MM,
    "needle_length": ASSUMED_MM[:1] + STATED_MM[1:],
    "depth": (1.0, ASSUMED_MM[1]),
    "boundaries": (0.1, ASSUMED_MM[1]),
    "thickness": (0.1, ASSUMED_MM[1]),
}
# of a remark: `0,085 mm/px`
_SCALE = re.compile(r"(\d+(?:[.,]\d+)?) *([mcu]?m) *(?:/|per|pro|par) *(?:px|pixel)")
DRAFT = "the draft of the mapping"  #: its place in messages
DECISIVE = ("needle", "diameter", "modulus", "depth_zero", "bevel_side")  # assumptions that are listed first
MAX_SHOWN_CELLS = 4  # number of cells of a row on the screen
MAX_FIRST_VALUES = 3  # number of values of a column on the screen

Prompt = Callable[[str, str, str], str]  #: key or question, proposal, reason -> answer; "" takes the proposal
#: rows of the screen, what is not used and where, why the last change was refused -> `KEY=VALUE` that changes
#: the mapping; "" takes it
Review = Callable[[Sequence[dict[str, str]], Sequence[tuple[str, str]], str], str]


@dataclass(frozen=True)
class PreparedImport:
    """The mapping that reads files, what it has read, and the plan of the dataset."""

    mapping: MappingRecord
    content: ImportContent
    plan: ImportPlan
    unused: Sequence[tuple[str, str]] = ()  # what the files hold beside it, and where
    notes: Sequence[tuple[str, str]] = ()  # what was done with the curves
    columns: Sequence[dict[str, str]] = field(default_factory=list)  # of the screen


def prepare_import(
    paths: Sequence[Path],
    assignments: Sequence[tuple[str, str]] = (),
    mapping: Path | None = None,
    prompt: Prompt | None = None,
    review: Review | None = None,
) -> PreparedImport:
    """Return an import of files, ready to be written.

    `assignments`: keys of the mapping and their values, which are stated. `mapping`: a file that states all,
    so that nothing is drafted. `prompt`: who is asked what is open or assumed; None: nobody. `review`: who
    sees the drafted columns before anything is read by them.

    DataError of what is open and nobody answers, and of what files and mapping contradict.
    """
    if mapping is not None:
        record, unused = _load(mapping, assignments), list[tuple[str, str]]()
        files = [*_list_named(paths)]
        content = read_mapped(record, files, str(mapping))
    else:
        draft, files = complete_draft(paths, [*assignments], prompt, review)
        record, unused = draft.to_record(DRAFT), draft.unused
        content = read_mapped(record, files, DRAFT)
    _require_lengths(content)
    examples = find_examples(content.curves)
    record = _settle_origin(record, examples, prompt)
    values, assumed = dict(record.values), dict(record.assumed)
    settler = Settler(values, assumed, prompt, is_complete=mapping is not None)
    columns = [*_describe_columns(record, files)]
    plan, content = _make_plan(content, settler)
    assumed = {key: assumed[key] for key in dict.fromkeys((*DECISIVE, *assumed)) if key in assumed}
    record = record.model_copy(update={"values": values, "assumed": assumed})
    others = len(content.curves) - len(examples)
    plan = replace(plan, examples=tuple(examples) if others else ())
    return PreparedImport(record, content, plan, unused, settler.notes, columns)


def _make_plan(content: ImportContent, settler: Settler) -> tuple[ImportPlan, ImportContent]:
    """Return the plan and the curves that it placed; an answer that is refused is asked for again."""
    while True:
        placed, notes = deepcopy(content), [*settler.notes]
        try:
            return Planner(placed, settler).make_plan(), placed
        except DataError as error:
            if not settler.withdraw(error):
                raise
            settler.notes[:] = notes


def _settle_origin(record: MappingRecord, examples: Sequence[str], prompt: Prompt | None) -> MappingRecord:
    """Return the mapping with the origin of its needles: examples of the workbook are known by their points.

    The workbook to fill in states `example`: of needles that are none of them a person is asked.
    """
    if examples:
        return record.model_copy(update={"origin": "example"})
    if record.origin != "example":
        return record
    reason = "as the workbook states it, yet no needle is one of its examples; origin=measured if measured"
    if prompt is not None and (answer := prompt("origin", record.origin, reason)):
        return check(record.model_dump(by_alias=True) | {"origin": answer}, MappingRecord, "the answer")
    return record.model_copy(update={"assumed": {**record.assumed, "origin": f"example: {reason}"}})


def _load(mapping: Path, assignments: Sequence[tuple[str, str]]) -> MappingRecord:
    """Return the mapping of a file, with the values that are stated."""
    record = load(mapping, MappingRecord)
    if not assignments:
        return record
    keys = record.model_dump(mode="json", exclude_defaults=True, by_alias=True)
    stated = Assignments(assignments)
    pairs = [*((f"values.{key}", text) for key, text in stated.values.items()), *stated.numbered]
    if stated.origin:
        pairs.append(("origin", stated.origin))
    if stated.columns or stated.table or stated.unit:
        raise ConfigError(
            "beside a mapping columns are stated by the number of their table",
            expected=f'tables.1.columns.y.column = "HEADER", or an edit of {mapping}',
            fix="--set tables.1.columns.MEANING.column=HEADER",
        )
    return check(override(keys, pairs, str(mapping)), MappingRecord, mapping)


def _list_named(paths: Sequence[Path]) -> Iterator[Path]:
    for path in paths:
        yield from sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else (path,)


def complete_draft(
    paths: Sequence[Path],
    assignments: list[tuple[str, str]],
    prompt: Prompt | None = None,
    review: Review | None = None,
) -> tuple[Draft, list[Path]]:
    """Return a draft without open questions, as whoever sees it takes it.

    Answers and changes are stated as if by `--set`, and it is drafted again; one that is refused is asked for
    again.
    """
    taken, problem = len(assignments), ""  # number of the assignments by which a draft was made
    while True:
        try:
            draft, files = draft_mapping(paths, Assignments(assignments))
            if not draft.opens:
                _find_unit(draft, files)
            if draft.opens and prompt is None:
                raise draft.to_error()
            columns = [] if draft.opens else [*_describe_columns(draft.to_record(DRAFT), files)]
        except (ConfigError, DataError) as error:
            if len(assignments) == taken:
                raise
            del assignments[taken:]
            problem = str(error)
            continue
        taken = len(assignments)
        if draft.opens and prompt is not None:
            assignments += _ask(draft.opens[0], prompt, problem)
        else:
            change = "" if review is None else review(columns, draft.unused, problem)
            key, equals, value = change.partition("=")
            if not equals:
                return draft, files
            assignments.append((key.strip(), value.strip()))
        problem = ""


def _ask(question: Open, prompt: Prompt, problem: str = "") -> list[tuple[str, str]]:
    """Return the keys that an answer states; `problem`: why an earlier answer was refused."""
    words = ", ".join(question.choices)
    answer = prompt(
        f"{question.question} ({words})" if words else question.question, "", problem or question.where
    )
    if not words:
        return [(question.key, answer)]
    if answer not in question.choices:
        return _ask(question, prompt, f"the answer is {answer[:40]!r}; expected: one of {words}")
    keys = question.choices[answer]
    return [(key, prompt(key, "", "") if text == "VALUE" else text) for key, text in keys.items()]


def _find_unit(draft: Draft, files: Sequence[Path]) -> None:
    """Assume or ask for a unit that nothing states."""
    lacking = [
        column
        for table in draft.tables
        for meaning, column in table["columns"].items()
        if meaning in COORDINATES and "unit_column" not in column and table["holds"] in POINTS
        if column.get("unit", "px") == "px"
    ]
    if any("unit" in column for column in lacking):
        scales = [scale for line, _ in draft.unused if (scale := _SCALE.search(line))]
        steps = {f"{scale[1].replace(',', '.')} {scale[2]}" for scale in scales}
        answers = {step: {"unit": step} for step in steps}
        draft.ask("unit", files[0].name, answers, reason="A header states pixels")
    elif lacking:
        curves = read_curves([*list_tables(draft.to_record(DRAFT), files, DRAFT)], [])
        _settle_unit(draft, files[0].name, curves, lacking)
    if not draft.opens:
        _doubt_units(draft, list_tables(draft.to_record(DRAFT), files, DRAFT))


def _settle_unit(
    draft: Draft, file: str, curves: Sequence[ImportedCurve], lacking: Sequence[dict[str, str]]
) -> None:
    """Assume mm of lengths without a unit where needles then have the length of one; else ask."""
    longest, (low, high) = max((curve.reach for curve in curves), default=0.0), ASSUMED_MM
    if all((curve.line == np.round(curve.line)).all() for curve in curves):
        draft.ask("unit", file, reason="All coordinates are whole numbers, as of pixels")
    elif low <= longest <= high:
        for column in lacking:
            column["unit"] = "mm"
        draft.assumed["unit"] = f"mm: the longest needle is then {longest:.3g} mm long"
    else:
        likely = {name: {"unit": name} for name, mm in UNITS_MM.items() if low <= mm * longest <= high}
        draft.ask("unit", file, likely, reason=f"In mm the longest needle is {longest:,.3g} mm long")


def _doubt_units(draft: Draft, tables: Iterable[MappedTable]) -> None:
    """Ask in what unit lengths are that state none, where no needle has them in the unit that is assumed."""
    for mapped in tables:
        for meaning, (low, high) in LENGTHS_MM.items():
            if f"{meaning}.unit" not in draft.assumed or meaning not in mapped.record.columns:
                continue
            column = mapped.record.columns[meaning]
            cells = {cell for cells in mapped.cells[meaning] for cell in cells}
            numbers = [number for cell in cells for number in list_bare_numbers(cell) if number]
            fits = {
                unit: all(low <= number * factor <= high for number in numbers)
                for unit, factor in UNITS_MM.items()
            }
            unit = column.unit or "mm"
            if numbers and not fits[unit]:
                answers = {name: {f"{meaning}.unit": name} for name, is_likely in fits.items() if is_likely}
                shown = f"{max(numbers):g} {unit}"
                draft.ask("length", mapped.table.path.name, answers, key=meaning, shown=shown)


def _require_lengths(content: ImportContent) -> None:
    """DataError if no needle has a length that is possible."""
    longest, (low, high) = max(curve.reach for curve in content.curves), STATED_MM
    if longest and not low <= longest <= high:
        raise DataError(
            f"the longest needle is {longest:,.3g} mm long",
            expected=f"{low:g} to {high:g} mm",
            fix=(
                f"state the unit of the coordinates, as {name_set('unit', 'mm' if longest > high else 'm')}"
            ),
            where=content.curves[0].points.where(),
        )


def _describe_columns(record: MappingRecord, files: Sequence[Path]) -> Iterator[dict[str, str]]:
    """Yield a row of the screen for each meaning of each table: column, unit, first values in mm."""
    for mapped in list_tables(record, files, "the mapping"):
        sheet = mapped.record.sheet.replace("*", "")
        for meaning, column in mapped.record.columns.items():
            unit = column.unit or MEANINGS[meaning].unit
            key = "unit" if meaning in COORDINATES and mapped.record.holds in POINTS else f"{meaning}.unit"
            unit += ", assumed" if unit and key in record.assumed else ""
            yield {
                "table": f"{mapped.table.path.name} {sheet}".strip(),
                "meaning": meaning,
                "column": ", ".join(map(str, column.columns)) or column.source or f"= {column.value}",
                "unit": f"column {column.unit_column}" if column.unit_column else unit,
                "first values": ", ".join(_list_first(mapped, meaning)),
            }


def _list_first(mapped: MappedTable, meaning: str) -> Sequence[str]:
    """Return the first values of a meaning, lengths in mm; of texts those that differ."""
    is_length = MEANINGS[meaning].unit == "mm" and meaning not in ("diameter", "entry_point")
    values = list[str]()
    for n, cells in enumerate(mapped.cells[meaning]):
        numbers = [mapped.table.number(cell) if is_length else None for cell in cells[:MAX_SHOWN_CELLS]]
        value = "; ".join(
            cell if number is None else f"{number * mapped.read_factor(meaning, n):.4g} mm"
            for cell, number in zip(cells, numbers, strict=False)
        )
        if any(cells) and (is_length or value not in values):
            values.append(value)
        if len(values) == MAX_FIRST_VALUES:
            break
    return values
