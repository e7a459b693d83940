"""Which keys of files decide the numbers of a fit: all but those that are listed here."""

from collections.abc import Collection, Mapping
from typing import Any

from pydantic import BaseModel

#: keys that decide no number, in whichever table they stand, and why
UNDECIDING: Mapping[str, str] = {
    "schema_": "layout of the file",
    **dict.fromkeys(("name", "title", "question"), "heading or label"),
    **dict.fromkeys(("note", "notes", "license", "source", "how_to_get"), "free text"),
    "margin_for": "words beside `margin_mm`",
    "paper_study": "numbers of the paper, printed beside ours",
    "preliminary": "label of verdicts",
    **dict.fromkeys(("truth", "truth_seed", "truth_population"), "true parameters, which no fit knows"),
    "sha256": "checksum of the table that a prior is from",
    "import_": "how values were found; the values decide",
    "checksums": "compared with the files when they are read",
}


def select_deciding(value: Any, but: Collection[str] = ()) -> Any:  # noqa: ANN401 - any value of a key
    """Return the keys of a table that decide, and those of the tables within it, but for defaults.

    So a key that states its default is as one that is left out, and one that a later version adds changes
    nothing where it is not stated.

    Keys in `but`, wherever they stand, are left out too: what follows from them is known by itself.
    """
    if isinstance(value, BaseModel):
        return {
            name: stated
            for name, field in type(value).model_fields.items()
            if name not in UNDECIDING
            and name not in but
            and (stated := select_deciding(getattr(value, name), but))
            != select_deciding(field.get_default(call_default_factory=True), but)
        }
    if isinstance(value, Mapping):
        return {key: select_deciding(part, but) for key, part in value.items()}
    return [select_deciding(part, but) for part in value] if isinstance(value, tuple) else value
