"""Facts: what a row states of a needle, of a specimen, or of all."""

from collections.abc import Sequence

from needlefit.datasets.importing.draft_table import OF_LAYERS, Columns, TableDraft
from needlefit.datasets.importing.kinds import ImportedCurve, RowKind
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.meanings import ATTRIBUTES
from needlefit.grouping import group_values


def propose_facts(draft: TableDraft, is_stated: bool) -> dict[str, Columns]:
    """Return no columns but those of all, where a table without points states something of needles."""
    if OF_LAYERS & draft.taken.keys() and not _is_of_each(draft, "medium"):  # the tissue of each layer
        draft.used -= {column.place for column in draft.taken.pop("medium")}
    stated, keys = draft.taken.keys() & {*ATTRIBUTES}, draft.keys
    if "needle" in draft.taken and stated:
        keys["of"] = "needle"
    elif "specimen" in draft.taken and len(stated) > 1:
        keys["of"] = "specimen"
    elif stated and (len(draft.table.rows) == 1 or stated <= OF_LAYERS):  # or a row for each layer
        keys["of"] = "all"
    else:
        return {}
    return {"": {}}


def _is_of_each(draft: TableDraft, meaning: str) -> bool:
    """Whether the rows of a needle, a specimen or all, have one text of a meaning, or none."""
    named = draft.taken.get("needle") or draft.taken.get("specimen") or []
    texts = group_values(
        (tuple(row[column.place] for column in named), row[column.place])
        for column in draft.taken.get(meaning, ())
        for row in draft.table.rows
    )
    return all(len({*values}) == 1 for values in texts.values())


def read_stated(mapped: MappedTable, curve: ImportedCurve, rows: Sequence[int]) -> None:
    """Add facts to a needle; of a specimen, by which it was found, the others."""
    facts = mapped.read_facts(rows)
    if mapped.record.of == "specimen":
        facts.pop("specimen", None)
    curve.state(facts)


FACTS = RowKind("facts", propose_facts, 1, is_of_each=True, read=read_stated)
