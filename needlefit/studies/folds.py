"""Divide the insertions of a loaded study into folds; refuse, before hours of work, what cannot be fitted."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from needlefit.datasets.dataset_warnings import is_copy
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.planes import describe_compared, find_left_planes, set_compared
from needlefit.datasets.select import select_insertions
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.forward_model import make_options as mesh
from needlefit.inference.likelihood.observations import OBSERVATIONS
from needlefit.inference.likelihood.observations.curvature import require_curvature
from needlefit.mechanics.plan import check_size, count_element_solves
from needlefit.project.locate import join_names
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import add_key_context, locate_key
from needlefit.schemas.limits import MAX_EVALUATION_ELEMENT_SOLVES
from needlefit.schemas.study import FitRecord, FoldsRecord, StudyRecord
from needlefit.studies.job import Fold, Job, Settings, load_study

MAX_NAMED_SPECIMENS = 8  #: specimens that a warning names
#: kinds of warnings that are also printed before the work, which takes long and is of no use then
DATA_WARNINGS = ("units", "bevel_side", "axis_unit", "common_pose", "data_changed")
_GUIDE_PARAMETER = "guide_distance_mm"


def prepare(
    name: str, record: FitRecord | StudyRecord, settings: Settings, dataset: Dataset | None = None
) -> Job:
    """Load a study or fit, as `load_study`, with its folds."""
    return add_folds(load_study(name, record, settings, dataset))


def add_folds(job: Job) -> Job:
    """Return a loaded study with its folds, and whether its needles are compared in a plane or in space.

    Raises ConfigError if the folds cannot be made, or an insertion cannot be fitted as the study states.
    """
    folds = make_folds(job.record, job.dataset)
    chosen = [one for fold in folds for one in (*fold.tune, *fold.validate)]
    with add_key_context("compared"):
        dataset = set_compared(job.dataset, chosen, job.record.compared, job.medium.torsional_friction_n)
    folds = tuple(fold.of_dataset(dataset) for fold in folds)
    warnings = [*job.warnings]
    warnings += find_left_planes(job.dataset, chosen, job.record.compared, job.place("compared"))
    if isinstance(job.record, StudyRecord) and not job.record.same_specimen:
        key = next(one for one in ("leave_out", "folds", "validate") if getattr(job.record, one, True))
        warnings += warn_shared_specimens(job.name, folds, job.place(key))
    divided = replace(job, dataset=dataset, folds=folds, warnings=tuple(warnings), measured=job.dataset)
    _check_registration(divided)
    _check_layers(divided)
    if divided.recipe.likelihood.measurement == "curvature":
        for insertion in (each for fold in folds for each in fold.tune):
            require_curvature(insertion)
    check_reach(divided)
    _check_size(divided)
    return divided


def print_notes(job: Job, settings: Settings) -> None:
    """Print what a user wants to know of the data before the work, which takes long."""
    if job.record.compared is None and (note := describe_compared(job.dataset)):
        settings.note(note)
    for one in dict.fromkeys(job.warnings):
        if one.kind in DATA_WARNINGS:
            settings.note(f"warning: {one} ({one.help_command})")


# ---- the folds


def make_folds(record: FitRecord | StudyRecord, dataset: Dataset) -> tuple[Fold, ...]:
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
        divided = (_divide(n, one, record, dataset) for n, one in enumerate(record.folds, start=1))
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


def _divide(number: int, one: FoldsRecord, record: StudyRecord, dataset: Dataset) -> Iterator[Fold]:
    """Yield the folds of one of [[folds]], by its number; insertions that are predicted are not fitted to."""
    rule, key = record.layer_count_rule, f"folds.{number}"
    held = select_insertions(dataset, one.validate_, rule, f"{key}.validate")
    tuned = select_insertions(dataset, one.tune, rule, f"{key}.tune")
    count = min(one.parts or 1, len(held))
    for k in range(count):
        left = held[k::count]
        kept = tuple(each for each in tuned if each not in left)
        if not kept:
            raise ConfigError("all insertions are predicted, and none is fitted to", key=f"{key}.tune")
        name = one.name if one.parts is None else f"{one.name}-{k + 1}"
        yield Fold(name, kept, left)


def _require_no_copies(fold: Fold) -> Fold:
    """Return a fold; ConfigError if it holds out a copy of an insertion fitted to: it tests nothing."""
    pairs = ((one, other) for one in fold.validate for other in fold.tune if is_copy(one, other))
    if found := next(pairs, None):
        one, other = found
        raise ConfigError(
            f"{one.id} is held out, and is a copy of {other.id}, which is fitted to",
            expected="an insertion of its own: errors on a copy are those of the fit",
            fix=f"remove {one.id} from the dataset, or restore its own file",
            key="validate",
        )
    return fold


def warn_shared_specimens(name: str, folds: Iterable[Fold], where: str = "") -> list[ResultWarning]:
    """Return a warning if held-out insertions share specimens with those fitted to.

    Such a study says how well a model knows the specimens that it was fitted to, not others.
    """
    shared: dict[str, None] = {}
    for fold in folds:
        held = {one.specimen for one in fold.validate}
        shared |= dict.fromkeys(one.specimen for one in fold.tune if one.specimen in held)
    if not shared:
        return []
    named = join_names(list(shared), MAX_NAMED_SPECIMENS)
    what = f"insertions into a specimen are fitted to and held out ({named}): errors in new specimens may "
    fix = "hold out whole specimens, or write same_specimen = true in the study if it is meant"
    return [ResultWarning("same_specimen", f"{what}be larger", where or f"study {name}", fix)]


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


# ---- what is refused or doubted before the work


MIN_SCORED_READINGS = 2  #: fewest readings of a predicted track that are scored


def count_registered(track: Insertion, depth_mm: float) -> int:
    """Return how many readings of a track, down to a depth, place it in the tracker's frame."""
    return max(1, int(np.sum(track.points[:, 0] <= depth_mm)))


def _check_registration(job: Job) -> None:
    """Refuse tracks of which nothing is left to be predicted, or that nothing places in their frame."""
    tracks = [one for fold in job.folds for one in fold.validate if OBSERVATIONS[one.observed].on_the_way]
    if not tracks or not isinstance(job.record, StudyRecord):
        return
    if not job.dataset.noise.slope_sd:
        raise ConfigError(
            "by how much the slopes of runs differ in the tracker's frame is not stated",
            where=locate_key(job.dataset.path, "noise.slope_sd_deg"),
            expected="[noise] with slope_sd_deg above 0",
        )
    depth = job.record.registration_depth_mm
    if depth is None:
        raise ConfigError(
            "tip tracks are predicted, and nothing places them in the tracker's frame",
            key="registration_depth_mm",
            expected="the depth up to which a run's own readings do, mm",
        )
    for fold in job.folds:
        if other := {one.specimen for one in fold.validate} - {one.specimen for one in fold.tune}:
            raise ConfigError(
                f"runs into {', '.join(sorted(other))} would be predicted, and none is fitted to",
                key="folds" if job.record.folds else "validate",
                expected="runs into specimens that are fitted",
            )
    for track in tracks:
        if count_registered(track, depth) > len(track.points) - MIN_SCORED_READINGS:
            raise ConfigError(
                f"of run {track.id} nothing is left to be predicted: its readings end at "
                f"{track.depth:g} mm, and those down to {depth:g} mm place it",
                key="registration_depth_mm",
                expected=f"{MIN_SCORED_READINGS} readings below it, at least",
                fix="lower registration_depth_mm, or leave the run out",
            )


def _check_layers(job: Job) -> None:
    """Refuse a medium with fewer layers than an insertion meets."""
    count = f"{job.medium.layers} layer{'s' if job.medium.layers > 1 else ''}"
    for insertion in job.insertions:
        if max(insertion.sequence) > job.medium.layers:
            raise ConfigError(
                f"medium {job.record.medium} has {count}, insertion {insertion.id} meets "
                f"layer {max(insertion.sequence)}",
                fix="name the medium that the needle went into, or select other insertions",
                key="medium",
            )


def check_reach(job: Job) -> None:
    """Refuse, before hours of work, a needle too short for the deepest insertion and the farthest guide."""
    for insertion in job.insertions:
        stated = job.parameters.fixed.get(_GUIDE_PARAMETER, insertion.guide_distance or 0.0)
        _, guide = job.parameters.bounds.get(_GUIDE_PARAMETER, (0.0, stated))
        length = insertion.needle.length
        if insertion.depth + guide >= length:
            raise ConfigError(
                f"insertion {insertion.id} is {insertion.depth:g} mm deep; with a guide {guide:g} mm before "
                f"the tissue the needle of {length:g} mm is too short",
                where=job.place_in_medium(f"parameters.{_GUIDE_PARAMETER}"),
                expected=f"below {length - insertion.depth:g} mm",
                fix="lessen the guide's distance or its upper bound",
            )


def _check_size(job: Job) -> None:
    """Refuse, before hours of work, insertions of which a single evaluation would take a minute."""
    rules, total = mesh(job.medium), 0.0
    for insertion in job.insertions:
        try:
            check_size((insertion.depth,), rules)
        except ModelError as error:
            raise ConfigError(
                f"insertion {insertion.id}: {error.what}",
                where=job.place_in_medium("constraint_spacing_mm"),
                expected=error.expected,
                fix=error.fix,
            ) from None
        conditions = 1 + 2 * len(insertion.sequence) if job.recipe.likelihood.depths != "fixed" else 1
        total += conditions * count_element_solves((insertion.depth,), rules.spacing, rules.element)
    if total > MAX_EVALUATION_ELEMENT_SOLVES:
        raise ConfigError(
            f"{len(job.insertions)} insertions are {total:.3g} elements to be solved for in one evaluation",
            where=job.place_in_medium("constraint_spacing_mm"),
            expected=f"at most {MAX_EVALUATION_ELEMENT_SOLVES:.3g}",
            fix="select fewer insertions, or take a larger constraint spacing",
        )
