"""Prepare an import: a mapping that is given, or drafted and completed; what it reads; and the plan."""

import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.draft import Draft
from needlefit.datasets.importing.draft_files import EXAMPLE_SHEET, draft_mapping, list_files
from needlefit.datasets.importing.kinds import KINDS, ImportedCurve
from needlefit.datasets.importing.meanings import (
    COORDINATES,
    CURVATURE_AXES,
    MEANINGS,
    VALUES,
    Pairs,
    list_bare_numbers,
    list_factors,
)
from needlefit.datasets.importing.place import ImportPlan
from needlefit.datasets.importing.read import ImportContent, list_tables, read_curves, read_mapped
from needlefit.datasets.importing.stated import Question, Settler, UnansweredError, make_question, name_set
from needlefit.datasets.importing.tables import read_workbook
from needlefit.datasets.points import MIN_POINTS
from needlefit.errors import ConfigError, DataError
from needlefit.grouping import group_values
from needlefit.project.toml import check, load, override
from needlefit.schemas.mapping import MappingRecord

STATED_MM = (1.0, 2000.0)  # smallest and largest length (mm) of the longest needle by a stated unit
# pattern of a gauge in a name or a line: `22G x 150 mm`
_GAUGE = re.compile(r"(?<![^\W_])(1\d|2\d|3[0-4]) ?G(?![^\W_])")
# largest ratio of the longest needle to the shortest in one unit: of cm among mm it is near 10
MAX_LENGTH_RATIO = 8.0
WORKBOOK_FILE = Path(__file__).with_name("workbook.xlsx")
POINT_DECIMALS = 3  # decimals (of mm) by which examples are recognised: another unit rounds them otherwise
Places = frozenset[tuple[float, ...]]
DRAFT = "the draft of the mapping"  #: name of the draft in messages
# meanings of assumptions that are listed first
DECISIVE = ("needle", "diameter", "modulus", "depth_zero", "bevel_side")


@dataclass(frozen=True)
class PreparedImport:
    """The mapping that reads files, what it has read, and the plan of the dataset."""

    mapping: MappingRecord
    content: ImportContent
    plan: ImportPlan
    unused: Pairs = ()  # what the files hold beside it, and where
    notes: Pairs = ()  # what was done with the curves


class UnreadError(DataError):
    """What contradicts a mapping that was drafted; `error`: the same without the `mapping`."""

    def __init__(self, error: DataError, mapping: MappingRecord) -> None:
        super().__init__(**vars(error))
        self.error, self.mapping = error, mapping.model_copy(update={"is_draft": True})


#: a question, and why the last answer was refused -> the answer
Prompt = Callable[[Question, str], str]
#: what was prepared, and why the last change was refused -> `KEY=VALUE` that changes it; "" takes it
Review = Callable[[PreparedImport, str], str]


def prepare_import(
    paths: Sequence[Path],
    assignments: Pairs = (),
    mapping: Path | None = None,
    prompt: Prompt | None = None,
    review: Review | None = None,
) -> PreparedImport:
    """Return an import of files, ready to be written.

    `assignments`: keys of the mapping and their values, which are stated. `mapping`: a file that states all,
    so that nothing is drafted. `prompt`: who is asked what is open; None: nobody. `review`: who sees what is
    proposed and may change it. Answers and changes are stated as if by `--set`, and all is prepared again;
    one that is refused is asked for again.

    DataError of what is open and nobody answers, and of what files and mapping contradict: UnreadError of a
    mapping that was drafted.
    """
    stated, taken, problem = [*assignments], len(assignments), ""
    while True:
        try:
            prepared = _prepare(paths, stated, mapping)
        except (ConfigError, DataError) as error:
            if isinstance(error, UnansweredError) and prompt is not None:
                taken = len(stated)
                stated += error.question.answer(prompt(error.question, problem))
                problem = f"expected: {error.expected}" if len(stated) == taken else ""
            elif len(stated) > taken:
                del stated[taken:]
                problem = str(error)
            else:
                raise
        else:
            key, _, value = ("" if review is None else review(prepared, problem)).partition("=")
            if not key:
                return prepared
            taken, problem = len(stated), ""
            stated.append((key.strip(), value.strip()))


def _prepare(paths: Sequence[Path], assignments: Pairs, mapping: Path | None) -> PreparedImport:
    if mapping is None:
        draft, files = complete_draft(paths, assignments)
        record, unused, where = draft.to_record(DRAFT), draft.unused, DRAFT
    else:
        record, unused, where = _load(mapping, assignments), [], str(mapping)
        files = list_files(paths, [])
    try:
        return _plan(record, files, where, unused)
    except DataError as error:
        if mapping is not None or isinstance(error, UnansweredError):
            raise
        raise UnreadError(error, record) from None


def _plan(record: MappingRecord, files: Sequence[Path], where: str, unused: Pairs) -> PreparedImport:
    """Return what a mapping reads, and the plan of it."""
    content = read_mapped(record, files, where)
    _require_lengths(content, record)
    examples = find_examples(content.curves)
    values, assumed = dict(record.values), dict(record.assumed)
    if not examples and record.origin == "example":
        assumed["origin"] = "example: as the workbook states it; origin=measured if measured"
    if content.left_out:
        left_out = "; ".join(content.left_out)
        assumed["missing"] = f"points without a measured coordinate are left out: {left_out}"
    cells = [curve.stated for curve in content.curves]
    settler = Settler(values, assumed, cells, is_complete=where != DRAFT and not record.is_draft)
    plan = ImportPlan(content, settler)
    others = {key for key, meaning in VALUES.items() if meaning.of in ("import", "dataset")}
    for key in record.values:
        if key not in {*record.assumed, *settler.used, *others}:
            settler.note(key, "not used: nothing of these needles depends on it")
    assumed = {key: assumed[key] for key in dict.fromkeys((*DECISIVE, *assumed)) if key in assumed}
    origin = "example" if examples else record.origin
    settled = {"values": values, "assumed": assumed, "origin": origin, "is_draft": False}
    record = record.model_copy(update=settled)
    if len(examples) < len(content.curves):
        plan.examples = tuple(examples)
    return PreparedImport(record, content, plan, unused, settler.notes)


def _load(mapping: Path, assignments: Pairs) -> MappingRecord:
    """Return the mapping of a file, with the values that are stated."""
    record = load(mapping, MappingRecord)
    keys = record.model_dump(mode="json", exclude_defaults=True, by_alias=True)
    pairs = [
        (f"values.{key}" if key in VALUES else key, json.dumps(text))
        if key in VALUES or key.startswith("needles.")
        else (key, text)
        for key, text in assignments
    ]
    return check(override(keys, pairs, str(mapping)), MappingRecord, mapping)


def complete_draft(paths: Sequence[Path], assignments: Pairs) -> tuple[Draft, list[Path]]:
    """Return a draft and its files; UnansweredError if it leaves something open."""
    draft, files = draft_mapping(paths, assignments)
    if not draft.opens:
        try:
            _settle_units(draft, files)
        except DataError as error:
            raise UnreadError(error, draft.to_record(DRAFT)) from None
    texts = " ".join([*(text for text, _ in draft.unused), *set().union(*draft.needles.values())])
    gauges = {f"{number}G" for number in _GAUGE.findall(texts.replace("_", " "))}
    if gauges and not any(
        "diameter" in named for named in (draft.values, *(t["columns"] for t in draft.tables))
    ):
        answers = {gauge: {"diameter": gauge} for gauge in sorted(gauges)}
        draft.ask("diameter", files[0].name, answers, gauge=", ".join(answers))
    if draft.opens:
        raise UnansweredError(*draft.opens)
    return draft, files


# ---- units


def _settle_units(draft: Draft, files: Sequence[Path]) -> None:
    """Assume mm of lengths that state no unit where needles have such lengths; else ask for the unit.

    Of coordinates it is that of the longest needle; of curvatures, which are 0 in some places, the greatest.
    """
    tables, file = [*list_tables(draft.to_record(DRAFT), files, DRAFT)], files[0].name
    lacking = [
        column
        for table in draft.tables
        for meaning, column in table["columns"].items()
        if meaning in COORDINATES and "unit_column" not in column and KINDS[table["holds"]].has_points
        if column.get("unit", "px") == "px"
    ]
    if any("unit" in column for column in lacking):
        draft.ask("unit", file, reason="A header states pixels")
        return
    if lacking:
        curves = read_curves(tables, [])
        longest = max((curve.reach for curve in curves), default=0.0)
        if all((curve.line == np.round(curve.line)).all() for curve in curves):
            draft.ask("unit", file, reason="All coordinates are whole numbers, as of pixels")
        elif "mm" in (units := _list_likely("x", [longest])):
            for column in lacking:
                column["unit"] = "mm"
            draft.assumed["unit"] = f"mm: the longest needle is then {longest:.3g} mm long"
        else:
            likely = {unit: {"unit": unit} for unit in units}
            draft.ask("unit", file, likely, reason=f"In mm the longest needle is {longest:,.3g} mm long")
    for mapped in tables:
        for meaning, column in mapped.record.columns.items():
            usual = MEANINGS[meaning].unit
            is_curvature = usual == "1/mm"  # its unit is asked beside a header, too: 1/mm is written as 1/m
            is_open = is_curvature and "unit" not in draft.columns.get(meaning, {})
            if not (f"{meaning}.unit" in draft.assumed or is_open) or not MEANINGS[meaning].likely:
                continue
            alike = [*mapped.record.columns.keys() & {*CURVATURE_AXES}] if is_curvature else [meaning]
            texts = {cell for key in alike for cells in mapped.cells[key] for cell in cells}
            numbers = sorted(abs(number) for text in texts for number in list_bare_numbers(text) if number)
            units, unit = (
                _list_likely(meaning, numbers[-1:] if is_curvature else numbers),
                column.unit or usual,
            )
            if numbers and unit not in units:
                answers = {name: {f"{key}.unit": name for key in sorted(alike)} for name in units}
                shown = f"{numbers[-1]:g} {unit}"
                draft.ask("length", mapped.path.name, answers, key=meaning, shown=shown)


def _list_likely(meaning: str, numbers: Sequence[float]) -> list[str]:
    """Return the units in which all numbers are likely."""
    low, high = MEANINGS[meaning].likely
    units = list_factors(MEANINGS[meaning].unit)
    return [
        unit for unit, factor in units.items() if all(low <= number * factor <= high for number in numbers)
    ]


def _require_lengths(content: ImportContent, record: MappingRecord) -> None:
    """DataError if no needle has a length that is possible; ask where one is in another unit, perhaps."""
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
    shapes = [curve for curve in content.curves if curve.kind.has_shape and "depth" not in curve.stated]
    short = min(shapes, key=lambda curve: curve.reach, default=None)
    if short is None or "lengths" in record.values or longest < MAX_LENGTH_RATIO * short.reach:
        return
    where = short.points.where()
    raise UnansweredError(
        make_question("lengths", where, name=short.name, reach=short.reach, longest=longest)
    )


# ---- the workbook that ships


def find_examples(curves: Iterable[ImportedCurve]) -> list[str]:
    """Return the names of the curves, in mm, all of whose points are points of one example."""
    lines = {curve.name: curve.line for curve in curves if len(curve.line) >= MIN_POINTS}
    return [name for name, line in lines.items() if any(map(_place(line).issubset, _load_examples()))]


@cache
def _load_examples() -> list[Places]:
    """Return the points of each example."""
    _, *rows = dict(read_workbook({}, str(WORKBOOK_FILE)))[f"{EXAMPLE_SHEET} points"]
    lines = group_values((name, point) for name, *point in rows)
    return [_place(np.array(line, dtype=np.float64)) for line in lines.values()]


def _place(line: Floats) -> Places:
    return frozenset(map(tuple, (line.round(POINT_DECIMALS) + 0.0).tolist()))
