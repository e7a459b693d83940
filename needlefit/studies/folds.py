"""Split insertions into those fitted to and those scored: one fold, or one per group left out."""

from collections.abc import Iterable
from dataclasses import dataclass

from needlefit.datasets.dataset_warnings import is_copy
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.select import select_insertions
from needlefit.errors import ConfigError
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.study import FitRecord, StudyRecord

MAX_NAMED_SPECIMENS = 8  #: specimens that a warning names


@dataclass(frozen=True)
class Fold:
    """One fold: the insertions fitted to and those scored."""

    name: str
    tune: tuple[Insertion, ...]
    validate: tuple[Insertion, ...]


def make_folds(record: FitRecord | StudyRecord, dataset: Dataset) -> tuple[Fold, ...]:
    """Return the folds of a study, or the single fold of a fit, which scores nothing.

    Raises ConfigError if a selection matches nothing, an insertion stands on both sides, or there is nothing
    to leave out.
    """
    tune = select_insertions(dataset, record.tune, record.layer_count_rule)
    if not isinstance(record, StudyRecord):
        return (Fold("all", tune, ()),)
    if record.leave_out is not None:
        return leave_out(tune, record.leave_out)
    validate: dict[str, Insertion] = {}
    for n, selection in enumerate(record.validate_, start=1):
        chosen = select_insertions(dataset, selection, record.layer_count_rule, f"validate.{n}")
        validate |= {insertion.id: insertion for insertion in chosen}
    both = sorted(validate.keys() & {insertion.id for insertion in tune})
    if both:
        raise ConfigError(
            f"{', '.join(both)} would both tune and validate",
            expected="insertions on one side only",
            fix="narrow [tune] or [[validate]]",
            key="validate",
        )
    return (Fold("all", tune, tuple(validate.values())),)


def warn_shared_specimens(name: str, folds: Iterable[Fold], where: str = "") -> list[ResultWarning]:
    """Return a warning if held-out insertions share specimens with those fitted to.

    Such a study says how well a model knows the specimens that it was fitted to, not others.
    """
    shared: dict[str, None] = {}
    for fold in folds:
        held = {one.specimen for one in fold.validate}
        shared |= dict.fromkeys(one.specimen for one in fold.tune if one.specimen in held)
        copies = (one for one in fold.validate if any(is_copy(one, other) for other in fold.tune))
        shared |= dict.fromkeys(f"{one.id}, a copy of one fitted to" for one in copies)
    return [specimen_warning(name, list(shared), where)] if shared else []


def specimen_warning(name: str, specimens: list[str], where: str = "") -> ResultWarning:
    """Return the warning that a study, `name` at `where`, is fitted to specimens that it is validated on."""
    named = join_names(specimens, MAX_NAMED_SPECIMENS)
    return ResultWarning(
        "same_specimen",
        f"insertions into a specimen are fitted to and held out ({named}): errors in new specimens may "
        "be larger",
        where or f"study {name}",
        "hold out whole specimens, or write same_specimen = true in the study if it is meant",
    )


def leave_out(insertions: tuple[Insertion, ...], what: str) -> tuple[Fold, ...]:
    """Return one fold for each "insertion" or "specimen", which it leaves out.

    Raises ConfigError if there is only one.
    """
    held = group_insertions(insertions, what)
    if len(held) < 2:
        within = what == "specimen" and len(insertions) > 1
        raise ConfigError(
            f"there is only one {what}: none can be left out",
            expected=f"insertions into two {what}s or more" if within else f"two {what}s or more",
            fix='write leave_out = "insertion" and same_specimen = true to predict insertions into this '
            "specimen, or add insertions into another one"
            if within
            else "select more insertions",
            key="leave_out",
        )
    return tuple(
        Fold(f"without {name}", tuple(i for i in insertions if i not in members), members)
        for name, members in held.items()
    )


def group_insertions(insertions: tuple[Insertion, ...], what: str) -> dict[str, tuple[Insertion, ...]]:
    """Group the insertions by "specimen", or each "insertion" by itself, in their order."""
    names = [insertion.specimen if what == "specimen" else insertion.id for insertion in insertions]
    return {
        name: tuple(i for i, own in zip(insertions, names, strict=True) if own == name)
        for name in dict.fromkeys(names)
    }
