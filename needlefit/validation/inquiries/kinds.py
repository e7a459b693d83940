"""The kinds of inquiry: what a study file of each holds, and the verb that asks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from needlefit.errors import ConfigError
from needlefit.project.load import load, read_toml
from needlefit.project.places import label
from needlefit.project.records.adaptation import AdaptationRecord
from needlefit.project.records.comparison import ComparisonRecord
from needlefit.project.records.inquiry import InquiryRecord
from needlefit.project.records.left_out import LeftOutRecord
from needlefit.project.records.next_insertion import NextInsertionRecord
from needlefit.project.records.plan import PlanRecord
from needlefit.project.records.seeds import SeedsRecord
from needlefit.project.records.sensitivity import SensitivityRecord
from needlefit.project.records.specimens import SpecimensRecord
from needlefit.project.threads import one_thread
from needlefit.validation.inquiries import left_out
from needlefit.validation.inquiries.adaptation import verb as adaptation
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.blamed import blamed
from needlefit.validation.inquiries.comparison import verb as comparison
from needlefit.validation.inquiries.planning import next_insertion, plan
from needlefit.validation.inquiries.specimens import verb as specimens
from needlefit.validation.inquiries.tables.seeds import verb as seeds
from needlefit.validation.inquiries.tables.sensitivity import verb as sensitivity
from needlefit.validation.job import Settings


@dataclass(frozen=True)
class Kind:
    """What a study file of one kind holds, and what carries it out."""

    record: type[InquiryRecord]
    ask: Callable[[str, Any, Settings], Answer]


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "adaptation": Kind(AdaptationRecord, adaptation.ask),
        "comparison": Kind(ComparisonRecord, comparison.ask),
        "left_out": Kind(LeftOutRecord, left_out.ask),
        "next_insertion": Kind(NextInsertionRecord, next_insertion.ask),
        "plan": Kind(PlanRecord, plan.ask),
        "seeds": Kind(SeedsRecord, seeds.ask),
        "sensitivity": Kind(SensitivityRecord, sensitivity.ask),
        "specimens": Kind(SpecimensRecord, specimens.ask),
    }
)


def inquiry(path: Path) -> InquiryRecord | None:
    """Return what a study file asks, or None if it has no `kind`: such a study tunes and scores.

    Raises
    ------
    ConfigError
        If the kind is unknown, or the file does not hold what its kind wants.
    """
    kind = read_toml(path).get("kind")
    if kind is None:
        return None
    if not isinstance(kind, str) or kind not in KINDS:
        raise ConfigError(
            f"there is no kind of study called {kind!r}",
            where=f"{label(path)}, key `kind`",
            expected=f"one of {', '.join(KINDS)}, or no `kind`: then it tunes and scores",
        )
    return load(path, KINDS[kind].record)


@one_thread
def ask(name: str, record: InquiryRecord, settings: Settings) -> Answer:
    """Carry out an inquiry.

    The same record, data, seed and versions give the same frames for any number of jobs, and after an
    interruption with `resume`.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    """
    with blamed(name):
        return KINDS[record.kind].ask(name, record, settings)
