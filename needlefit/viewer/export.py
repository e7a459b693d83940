"""Files to take away, made from a recording."""

from pathlib import Path

KINDS = {"inputs.csv": "text/csv"}
"""What there is, and its type."""


def export(path: Path, subject: str, kind: str) -> bytes:
    """Return a file."""
    return path.read_bytes()
