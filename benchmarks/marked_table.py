"""A table of figures put into the page of the benchmarks, between two marks that name it."""

from collections.abc import Sequence
from pathlib import Path

PAGE = Path(__file__).resolve().parent / "README.md"


def write_table(name: str, rows: Sequence[Sequence[str]], note: str) -> None:
    """Put a table, its head first, and a line below it between `<!-- NAME -->` and `<!-- end NAME -->`."""
    head, *body = rows
    lines = ["| " + " | ".join(head) + " |", "|---" + "|---:" * (len(head) - 1) + "|"]
    lines += ["| " + " | ".join(row) + " |" for row in body]
    begin, end = f"<!-- {name} -->", f"<!-- end {name} -->"
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(begin, 1)
    _, after = rest.split(end, 1)
    PAGE.write_text(before + "\n".join([begin, "", *lines, "", note, "", end]) + after, encoding="utf-8")
