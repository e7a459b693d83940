"""What is proposed of a mapping, and what a person states of it: tables, values, what is open."""

from dataclasses import replace
from pathlib import Path

from needlefit.datasets.importing.meanings import MEANINGS, VALUES, Answers, Keys, Pairs
from needlefit.datasets.importing.stated import Question, make_question, name_set
from needlefit.errors import ConfigError
from needlefit.project.locate import sort_by_similarity
from needlefit.project.toml import check, override
from needlefit.schemas.mapping import MappingRecord, TableRecord

TABLE_KEYS = tuple(key for key in TableRecord.model_fields if key not in ("files", "columns"))
KEYS = ("unit", "origin", "surfaces", *TABLE_KEYS, *MEANINGS)
PARSED_PARTS = ("words", "sign")  # parts of a meaning that are parsed; the others are texts


class Draft:
    """A mapping that is proposed, what a person states of it, and what of it is assumed, open, or not used.

    `pairs`: keys that are stated, and their values. ConfigError if a key is not known.
    """

    def __init__(self, pairs: Pairs) -> None:
        self.values = dict[str, str]()  # of all needles, by meaning; setup sheets add theirs
        self.facts = dict[str, dict[str, str]]()  # stated of single needles, by name and meaning
        self.columns = dict[str, Keys]()  # stated ones, by meaning and part
        self.table_keys = Keys()  # stated keys of every table
        self.numbered = list[tuple[str, str]]()  # stated keys of one: `tables.2.sheet`
        self.planes = list[str]()  # files of points that are planes between layers
        self.unit = self.origin = ""
        self.tables = list[Keys]()  # keys of `TableRecord`
        self.surfaces = list[str]()
        self.assumed = dict[str, str]()
        self.opens = list[Question]()
        self.unused = list[tuple[str, str]]()  # what, and where it stands
        self.ignored = dict[str, list[str]]()  # columns of numbers of files of which nothing is read
        self.headers = list[str]()  # of all tables
        self.columns_read = set[str]()  # meanings whose stated columns are there
        self.names = dict[Path, str]()  # what files are called
        self.curves = set[str]()  # names of the needles that have points, in any table
        self.needles = dict[tuple[str, str], set[str]]()  # names by file and sheet
        for key, text in pairs:
            head, _, part = key.partition(".")
            if key in VALUES:
                self.values[key] = text
            elif key in ("unit", "origin"):
                setattr(self, key, text)
            elif key == "surfaces":
                self.planes += [name.strip() for name in text.split("|")]
            elif head == "needles":
                name, _, meaning = part.rpartition(".")
                self.facts.setdefault(name, {})[meaning] = text
            elif head == "tables":
                self.numbered.append((key, text))
            elif key in TABLE_KEYS:
                (value,) = override({}, [(key, text)], "--set").values()
                self.table_keys[key] = [*self.table_keys.get(key, []), *value] if key == "unused" else value
            elif head in MEANINGS:
                part = part or "column"
                is_list = part == "column" and text.startswith("[")
                value = (
                    override({}, [(part, text)], "--set")[part] if is_list or part in PARSED_PARTS else text
                )
                self.columns.setdefault(head, {})[part] = "|".join(map(str, value)) if is_list else value
            else:
                raise ConfigError(
                    f"--set {key}={text[:40]}: there is no key `{key}`",
                    expected="a key of the mapping: needlefit explain mapping",
                    fix=f"did you mean {name_set(sort_by_similarity(head, KEYS)[0], text)}",
                )

    def ask(
        self,
        question: str,
        where: str,
        choices: Answers | None = None,
        **parts: str | int,
    ) -> None:
        """Ask a question of `QUESTIONS`, unless it is asked already."""
        asked = make_question(question, where, choices, **parts)
        if not any(replace(other, where=where) == asked for other in self.opens):  # of one sheet
            self.opens.append(asked)

    def add(self, entry: Keys, path: Path) -> None:
        """Add the entry of a table; files that are read alike have one."""
        entry = entry | {"files": [name := self.names[path]]}
        same = next((table for table in self.tables if {**table, "files": 0} == {**entry, "files": 0}), None)
        if same is not None and name not in same["files"]:
            same["files"] = [*same["files"], name]
        else:
            self.tables.append(entry)

    def to_record(self, where: str) -> MappingRecord:
        """Return the mapping, checked."""
        keys = {
            "schema": MappingRecord.SCHEMA,
            "origin": self.origin or "measured",
            "surfaces": self.surfaces,
            "values": self.values,
            "needles": self.facts,
            "assumed": self.assumed,
            "tables": self.tables,
        }
        return check(keys, MappingRecord, where)
