"""Which insertions tune and which are scored: one fold, or one for each group left out."""

from dataclasses import dataclass

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.select import select
from needlefit.errors import ConfigError
from needlefit.project.records.fit import FitRecord
from needlefit.project.records.study import StudyRecord


@dataclass(frozen=True)
class Fold:
    """One fit and what it is scored on; no specimen left out stands on both sides."""

    name: str
    tune: tuple[Insertion, ...]
    validate: tuple[Insertion, ...]


def folds(record: FitRecord | StudyRecord, dataset: Dataset) -> tuple[Fold, ...]:
    """Return the folds of a study, or the single one of a fit, which scores nothing.

    Raises
    ------
    ConfigError
        If a selection matches nothing, an insertion stands on both sides, or there is nothing to leave out.
    """
    tune = select(dataset, record.tune, record.reading)
    if not isinstance(record, StudyRecord):
        return (Fold("all", tune, ()),)
    if record.leave_out is not None:
        return leave_out(tune, record.leave_out)
    validate: dict[str, Insertion] = {}
    for n, selection in enumerate(record.validate_, start=1):
        chosen = select(dataset, selection, record.reading, f"validate.{n}")
        validate |= {insertion.id: insertion for insertion in chosen}
    both = sorted(validate.keys() & {insertion.id for insertion in tune})
    if both:
        raise ConfigError(
            f"{', '.join(both)} would both tune and validate",
            expected="insertions on one side only",
            mend="narrow [tune] or [[validate]]",
            key="validate",
        )
    return (Fold("all", tune, tuple(validate.values())),)


def leave_out(insertions: tuple[Insertion, ...], what: str) -> tuple[Fold, ...]:
    """Return one fold for each "insertion" or "specimen", which it leaves out.

    Raises
    ------
    ConfigError
        If there is only one.
    """
    held = groups(insertions, what)
    if len(held) < 2:
        raise ConfigError(
            f"there is only one {what}: none can be left out",
            mend="select more, or give [[validate]]",
            key="leave_out",
        )
    return tuple(
        Fold(f"without {name}", tuple(i for i in insertions if i not in members), members)
        for name, members in held.items()
    )


def groups(insertions: tuple[Insertion, ...], what: str) -> dict[str, tuple[Insertion, ...]]:
    """Return the insertions by their "specimen", or each "insertion" by itself, in their order."""
    names = [insertion.specimen if what == "specimen" else insertion.id for insertion in insertions]
    return {
        name: tuple(i for i, own in zip(insertions, names, strict=True) if own == name)
        for name in dict.fromkeys(names)
    }
