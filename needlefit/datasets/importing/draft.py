"""What is proposed of a mapping: its tables and values, what is assumed, open, or not used."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from needlefit.datasets.importing.meanings import QUESTIONS
from needlefit.datasets.importing.stated import Question, UnansweredError, name_set
from needlefit.project.toml import check
from needlefit.schemas.mapping import MappingRecord


@dataclass
class Draft:
    """A mapping that is proposed, and what of it is assumed, open, or not used."""

    tables: list[dict[str, Any]] = field(default_factory=list)  # keys of `TableRecord`
    surfaces: list[str] = field(default_factory=list)
    values: dict[str, str] = field(default_factory=dict)
    assumed: dict[str, str] = field(default_factory=dict)
    opens: list[Question] = field(default_factory=list)
    unused: list[tuple[str, str]] = field(default_factory=list)  # what, and where it stands
    ignored: dict[str, str] = field(default_factory=dict)  # why nothing is read of a file, or of its sheets
    origin: str = "measured"
    headers: list[str] = field(default_factory=list)  # of all tables
    columns_read: set[str] = field(default_factory=set)  # meanings whose stated columns are there
    needles: dict[tuple[str, str], set[str]] = field(default_factory=dict)  # names by file and sheet

    def ask(
        self, question: str, where: str, choices: Mapping[str, Mapping[str, str]] | None = None, **parts: str
    ) -> None:
        """Ask a question of `QUESTIONS`, whose `parts` are filled in."""
        text, key, answers = QUESTIONS[question]
        filled = {
            answer: {key.format(**parts): value.format(**parts) for key, value in keys.items()}
            for answer, keys in answers.items()
        }
        asked = Question(key.format(**parts), text.format(**parts), choices or filled, where)
        if not any(replace(other, where=where) == asked for other in self.opens):  # of one sheet
            self.opens.append(asked)

    def to_error(self) -> UnansweredError:
        """Return the error of questions that nobody answers; its fix states what answers them."""
        plain = " ".join(name_set(question.key) for question in self.opens if not question.choices)
        fixes = [f"state {plain}"] if plain else []
        for question in filter(lambda question: question.choices, self.opens):
            options = (" ".join(map(name_set, keys, keys.values())) for keys in question.choices.values())
            fixes.append(f"state {', or '.join(options)}")
        return UnansweredError(
            f"needs an answer. {' '.join(question.text for question in self.opens)}",
            question=self.opens[0],
            expected=f"an answer to {'each' if len(self.opens) > 1 else 'it'}",
            fix="; ".join(fixes),
            where=self.opens[0].where,
        )

    def add(self, entry: dict[str, Any], path: Path) -> None:
        """Add the entry of a table; files that are read alike have one."""
        same = next((table for table in self.tables if {**table, "files": 0} == {**entry, "files": 0}), None)
        if same is not None and path.name not in same["files"]:
            same["files"] = [*same["files"], path.name]
        else:
            self.tables.append(entry)

    def to_record(self, where: str) -> MappingRecord:
        """Return the mapping, checked."""
        keys = {
            "schema": MappingRecord.SCHEMA,
            "origin": self.origin,
            "surfaces": self.surfaces,
            "values": self.values,
            "assumed": self.assumed,
            "tables": self.tables,
        }
        return check(keys, MappingRecord, where)
