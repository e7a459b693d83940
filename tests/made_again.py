"""A run's folder made again from what it stored."""

from pathlib import Path

from needlefit.studies.rebuild import rebuild


def assert_made_again(folder: Path) -> None:
    """Every file of a run but its times comes back to the same bytes; beside each figure lies its table."""
    again = folder.parent / f"{folder.name}-again"
    rebuild(folder, again)
    first, second = (
        {path.name: path.read_bytes() for path in where.iterdir() if path.name != "timing.json"}
        for where in (folder, again)
    )
    assert sorted(first) == sorted(second)
    assert [name for name in first if first[name] != second[name]] == []
    pictures = {name.removesuffix(".pdf") for name in first if name.endswith(".pdf")} - {"report"}
    assert pictures and {f"{name}.csv" for name in pictures} <= set(first)
