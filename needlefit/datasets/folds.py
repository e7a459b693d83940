"""Divide insertions into the folds of a study: those fitted to, and those held out."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.layers import SAME_POINT_MM
from needlefit.datasets.select import select_insertions
from needlefit.errors import ConfigError
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.study import FitRecord, FoldsRecord, StudyRecord

MAX_NAMED_SPECIMENS = 8  #: largest number of specimens that a warning names


@dataclass(frozen=True)
class Fold:
    """One fold: the insertions fitted to and those scored."""

    name: str
    tune: tuple[Insertion, ...]
    validate: tuple[Insertion, ...]

    def of_dataset(self, dataset: Dataset) -> "Fold":
        """Return the fold with the insertions of these ids as a dataset has them."""
        by_id = {insertion.id: insertion for insertion in dataset.insertions}
        tune, validate = (
            tuple(by_id[insertion.id] for insertion in part) for part in (self.tune, self.validate)
        )
        return replace(self, tune=tune, validate=validate)


def make_folds(record: FitRecord, dataset: Dataset) -> tuple[Fold, ...]:
    """Return the folds of a study, or the single fold of a fit, which scores nothing.

    Raises ConfigError if a selection matches nothing, an insertion or a copy of it stands on both sides, or
    there is nothing to leave out.
    """
    tune = select_insertions(dataset, record.tune, record.layer_count_rule)
    if not isinstance(record, StudyRecord):
        return (Fold("all", tune, ()),)
    if record.leave_out is not None:
        return tuple(map(_require_no_copies, leave_out(tune, record.leave_out)))
    if record.folds:
        divided = (_divide(n, fold, record, dataset) for n, fold in enumerate(record.folds, start=1))
        return tuple(_require_no_copies(fold) for folds in divided for fold in folds)
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
    return (_require_no_copies(Fold("all", tune, tuple(validate.values()))),)


def _divide(number: int, stated: FoldsRecord, record: StudyRecord, dataset: Dataset) -> Iterator[Fold]:
    """Yield the folds of one of [[folds]], by its number; insertions that are predicted are not fitted to."""
    rule, key = record.layer_count_rule, f"folds.{number}"
    held = select_insertions(dataset, stated.validate_, rule, f"{key}.validate")
    tuned = select_insertions(dataset, stated.tune, rule, f"{key}.tune")
    count = min(stated.parts or 1, len(held))
    for k in range(count):
        left = held[k::count]
        kept = tuple(insertion for insertion in tuned if insertion not in left)
        if not kept:
            raise ConfigError("all insertions are predicted, and none is fitted to", key=f"{key}.tune")
        name = stated.name if stated.parts is None else f"{stated.name}-{k + 1}"
        yield Fold(name, kept, left)


def _require_no_copies(fold: Fold) -> Fold:
    """Return a fold; ConfigError if it holds out a copy of an insertion fitted to: it tests nothing."""
    pairs = ((first, other) for first in fold.validate for other in fold.tune if is_copy(first, other))
    if copies := next(pairs, None):
        first, other = copies
        raise ConfigError(
            f"{first.id} is held out, and is a copy of {other.id}, which is fitted to",
            expected="an insertion of its own",
            fix=f"remove {first.id} from the dataset, or restore its own file",
            key="validate",
        )
    return fold


def warn_shared_specimens(name: str, folds: Iterable[Fold], where: str = "") -> list[ResultWarning]:
    """Return a warning if held-out insertions share specimens with those fitted to.

    Such a study says how well a model knows the specimens that it was fitted to, not others.
    """
    shared: dict[str, None] = {}
    for fold in folds:
        held = {insertion.specimen for insertion in fold.validate}
        shared |= dict.fromkeys(insertion.specimen for insertion in fold.tune if insertion.specimen in held)
    if not shared:
        return []
    named = join_names(list(shared), MAX_NAMED_SPECIMENS)
    problem = f"insertions into a specimen are fitted to and held out ({named}): errors in new ones may "
    fix = "hold out whole specimens, or write same_specimen = true"
    return [ResultWarning("same_specimen", f"{problem}be larger", where or f"study {name}", fix)]


def leave_out(insertions: tuple[Insertion, ...], kind: str) -> tuple[Fold, ...]:
    """Return one fold for each "insertion" or "specimen", which it leaves out.

    Raises ConfigError if there is only one.
    """
    held = divide_insertions(insertions, kind)
    if len(held) < 2:
        within = kind == "specimen" and len(insertions) > 1
        raise ConfigError(
            f"there is only one {kind}: none can be left out",
            expected=f"insertions into two {kind}s or more" if within else f"two {kind}s or more",
            fix='write leave_out = "insertion" and same_specimen = true, or add insertions into '
            "another specimen"
            if within
            else "select more insertions, or `needlefit tune`",
            key="leave_out",
        )
    return tuple(
        Fold(f"without {name}", tuple(i for i in insertions if i not in members), members)
        for name, members in held.items()
    )


def divide_insertions(insertions: tuple[Insertion, ...], kind: str) -> dict[str, tuple[Insertion, ...]]:
    """Group the insertions by "specimen", or each "insertion" by itself, in their order.

    A tip track and a shape of one hole were measured of one insertion.
    """
    tracked = {insertion.hole for insertion in insertions if insertion.in_tracker_frame and insertion.hole}
    keys = [insertion.hole if insertion.hole in tracked else insertion.id for insertion in insertions]
    names = [insertion.specimen for insertion in insertions] if kind == "specimen" else keys
    return {
        name: tuple(i for i, own_name in zip(insertions, names, strict=True) if own_name == name)
        for name in dict.fromkeys(names)
    }


def is_copy(one: Insertion, other: Insertion) -> bool:
    """Whether two insertions have the same shape, point by point; rounded tips may agree by chance."""
    a, b = one.centerline, other.centerline
    return a.shape == b.shape and len(a) > 2 and bool(np.abs(a - b).max() <= SAME_POINT_MM)
