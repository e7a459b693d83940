"""Names that a table, a page and a file can hold without doing anything.

A spreadsheet runs a cell that begins with `=`, `+`, `-` or `@`; control characters end lines and columns, and
formatting characters make a name look like another one.
"""

import unicodedata

from needlefit.errors import ConfigError

FORMULA_STARTS = frozenset("=+-@")  #: characters that begin a formula in a spreadsheet

#: largest size of a name (bytes): a file system takes 255, and what is written of a name has endings
MAX_NAME_BYTES = 200

EXPECTED_NAME = "a name without control characters that does not begin with =, +, - or @"
EXPECTED_FILE_NAME = f"{EXPECTED_NAME}, no / or \\: it names files"

_INVISIBLE = ("Cc", "Cf", "Cs", "Zl", "Zp")


def name_fault(name: str) -> str:
    """Return why a name is refused; empty if it is not. A name may be empty where a cell may."""
    if any(unicodedata.category(letter) in _INVISIBLE for letter in name):
        return "it holds a control or formatting character"
    if name and unicodedata.normalize("NFKC", name.lstrip())[:1] in FORMULA_STARTS:
        return f"a spreadsheet would run it, as it begins with {name.lstrip()[0]}"
    if len(name.encode("utf-8")) > MAX_NAME_BYTES:
        return f"it is longer than {MAX_NAME_BYTES} bytes"
    return ""


def file_name_fault(name: str) -> str:
    """Return why a name cannot name files; empty if it can."""
    if not name or name in (".", "..") or "/" in name or "\\" in name:
        return "it cannot name a file"
    return name_fault(name)


def require_file_name(name: str, where: str) -> None:
    """Raise ConfigError unless a name can name files; `where`: what gives it."""
    fault = file_name_fault(name)
    if fault:
        raise ConfigError(
            f"the name {name!r} is refused: {fault}",
            where=where if where.isprintable() else repr(where),
            expected=EXPECTED_FILE_NAME,
            fix="rename it",
        )
