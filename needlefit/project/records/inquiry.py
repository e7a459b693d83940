"""What every study has in common that asks something else than "tune on these, score on those"."""

from typing import Any

from needlefit.project.records.record import FileRecord


class InquiryRecord(FileRecord):
    """`studies/<name>.toml` with `kind = "..."`; every kind is a record of its own, with its own keys.

    `same_specimen = true` says that insertions are held out whose specimens are fitted to, on purpose.
    """

    kind: Any
    title: str = ""
    question: str = ""
    note: str = ""
    same_specimen: bool = False
