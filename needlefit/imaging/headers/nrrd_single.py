"""NRRD files of four axes of which one has a single entry: one volume, as a sequence of one holds it."""

import re
from pathlib import Path

from needlefit.imaging.headers.nrrd import header_fields

AXES = 4
_STEP = re.compile(r"none|\([^)]*\)", re.IGNORECASE)


def single_volume_header(path: Path) -> str:
    """Return a detached header (`.nhdr`) of a file of one volume, its fourth axis marked as a list.

    SimpleITK reads a list of one as a volume, and refuses an axis of another kind, or of none. Empty where
    the file has other axes than three of space and one of a single entry.
    """
    fields, header_lines = header_fields(path)
    steps, counts = _STEP.findall(fields.get("space directions", "")), fields.get("sizes", "").split()
    outside = [n for n, step in enumerate(steps) if step.lower() == "none"]
    if len(counts) != AXES or len(steps) != AXES or len(outside) != 1 or counts[outside[0]] != "1":
        return ""
    beside = fields.pop("data file", "")
    file = str((path.parent / beside if beside else path).resolve())
    if not file.isprintable() or "%" in file or (not beside and "line skip" in fields):
        return ""  # a header cannot name such a file
    if not beside:
        fields["line skip"] = str(header_lines)
    fields["kinds"] = " ".join("list" if n == outside[0] else "domain" for n in range(AXES))
    lines = [f"{name}: {value}" for name, value in fields.items()]
    return "\n".join(["NRRD0005", *lines, f"data file: {file}", ""])
