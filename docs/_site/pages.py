"""Pages that are written by the build."""

from pathlib import Path


def keep(path: Path, text: str) -> None:
    """Write a page, unless it stands there already: what is unchanged is not read again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
