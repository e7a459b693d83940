"""The keys that studies with a `kind` share; the keys of each kind are in its folder."""

from typing import Any, ClassVar

from needlefit.schemas.base import FileRecord


class QuestionRecord(FileRecord):
    """`studies/<name>.toml`: the keys that all studies but those of one fit share."""

    SCHEMA: ClassVar[int] = 2

    title: str = ""
    """Heading of the report."""
    question: str = ""
    """What the study answers; printed at the head of its report."""
    note: str = ""
    """Free text for readers of the file; it changes no result."""
    same_specimen: bool = False
    """Whether held-out insertions go on purpose into specimens that are fitted. Without it, that is a
    warning."""


class AnalysisRecord(QuestionRecord):
    """`studies/<name>.toml` with `kind = "..."`: the keys that all kinds share."""

    kind: Any
    """Kind of study."""


class TargetRecord(AnalysisRecord):
    """A study of the insertions that another study or fit is tuned on."""

    target: str
    """Study or fit whose insertions are analysed: its name, or the path of its file."""
