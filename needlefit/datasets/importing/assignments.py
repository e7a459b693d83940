"""What a person states of a mapping before it is drafted: `--set KEY=VALUE`."""

from collections.abc import Sequence
from typing import Any

from needlefit.datasets.importing.meanings import MEANINGS, VALUES
from needlefit.datasets.importing.stated import name_set
from needlefit.errors import ConfigError
from needlefit.project.locate import sort_by_similarity
from needlefit.project.toml import override
from needlefit.schemas.mapping import TableRecord

TABLE_KEYS = tuple(key for key in TableRecord.model_fields if key not in ("files", "columns"))
KEYS = ("unit", "origin", "surfaces", *TABLE_KEYS, *MEANINGS)
PARSED_PARTS = ("words", "sign")  # of a meaning; the others are texts


class Assignments:
    """The assignments by what they state: values of all needles, columns, keys of every table or of one.

    ConfigError if a key is not known.
    """

    def __init__(self, pairs: Sequence[tuple[str, str]] = ()) -> None:
        self.values = dict[str, str]()  # by meaning
        self.columns = dict[str, dict[str, Any]]()  # by meaning and part
        self.table = dict[str, Any]()  # keys of every table
        self.numbered = list[tuple[str, str]]()  # `tables.2.sheet`
        self.surfaces = list[str]()  # files of points that are planes between layers
        self.unit = self.origin = ""
        for key, text in pairs:
            head, _, part = key.partition(".")
            if key in VALUES:
                self.values[key] = text
            elif key in ("unit", "origin"):
                setattr(self, key, text)
            elif key == "surfaces":
                self.surfaces += [name.strip() for name in text.split("|")]
            elif head == "tables":
                self.numbered.append((key, text))
            elif key in TABLE_KEYS:
                stated = override({}, [(key, text)], "--set")
                if key == "unused":  # of several answers
                    stated[key] = [*self.table.get(key, []), *stated[key]]
                self.table |= stated
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
