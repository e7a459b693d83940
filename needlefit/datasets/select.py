"""Select the insertions of a dataset for a fit or a study, and group insertions that are not independent."""

from collections.abc import Iterable, Sequence

import numpy as np

from needlefit.datasets.insertion import Dataset, Insertion, TipTrack
from needlefit.errors import ConfigError
from needlefit.project.locate import join_names, sort_by_similarity
from needlefit.project.toml import add_key_context
from needlefit.schemas.study import LayerCountRule, SelectionRecord


def select_insertions(
    dataset: Dataset,
    selection: SelectionRecord,
    layer_count_rule: LayerCountRule = "listed",
    key: str = "tune",
) -> tuple[Insertion, ...]:
    """Return the insertions that match every key of `selection`, in the dataset's order.

    `layer_count_rule` decides which count of layers holds for an insertion that ends at a boundary; `key` is
    where the selection stands in its file. ConfigError if a medium, specimen or insertion is unknown, or no
    insertion is left.
    """
    known = dataset.insertions
    with add_key_context(f"{key}.medium"):
        _require_known("medium", _list_media(selection) or (), dataset.media)
    with add_key_context(f"{key}.specimens"):
        _require_known("specimen", selection.specimens or (), {insertion.specimen for insertion in known})
    with add_key_context(f"{key}.insertions"):
        _require_known("insertion", selection.insertions or (), {insertion.id for insertion in known})
    chosen = tuple(insertion for insertion in known if _matches(insertion, selection, layer_count_rule))
    if not chosen:
        given = selection.model_dump(exclude_none=True)
        raise ConfigError(
            f"no insertion of dataset {dataset.name} has "
            f"{' and '.join(map(_format_key, given, given.values()))}",
            expected="a selection that leaves at least one; there are "
            f"{_describe_choices(known, layer_count_rule)}",
            fix="widen or correct the selection",
            key=key,
        )
    return chosen


def count_layers(insertion: Insertion, layer_count_rule: LayerCountRule) -> int:
    """Return the number of layers that an insertion traverses, counted by the given rule."""
    return insertion.layers if layer_count_rule == "listed" else insertion.layers_alternative


def get_other_rule(layer_count_rule: LayerCountRule) -> LayerCountRule:
    """Return the rule of counting layers that a study does not use."""
    return "alternative" if layer_count_rule == "listed" else "listed"


def _matches(insertion: Insertion, selection: SelectionRecord, layer_count_rule: LayerCountRule) -> bool:
    low, high = selection.depth_min_mm, selection.depth_max_mm
    return (
        (selection.medium is None or insertion.medium in _list_media(selection))
        and (selection.layers is None or count_layers(insertion, layer_count_rule) in selection.layers)
        and (selection.specimens is None or insertion.specimen in selection.specimens)
        and (selection.insertions is None or insertion.id in selection.insertions)
        and (low is None or insertion.depth >= low)
        and (high is None or insertion.depth <= high)
        and (
            selection.guided is None
            or (isinstance(insertion, TipTrack) and insertion.guided == selection.guided)
        )
    )


def _list_media(selection: SelectionRecord) -> tuple[str, ...]:
    wanted = selection.medium
    return (wanted,) if isinstance(wanted, str) else (wanted or ())


def _format_key(key: str, value: object) -> str:
    """Return a key of a selection and its value as they are in the file."""
    values = value if isinstance(value, tuple) else (value,)
    listed = ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in values)
    return f"{key} = {f'[{listed}]' if isinstance(value, tuple) else listed}"


def _describe_choices(insertions: Iterable[Insertion], layer_count_rule: LayerCountRule) -> str:
    """Return what there is to select from: by medium, how many, of how many layers, how deep."""
    by_medium: dict[str, list[Insertion]] = {}
    for insertion in insertions:
        by_medium.setdefault(insertion.medium, []).append(insertion)
    choices = []
    for medium, group in by_medium.items():
        layers = ", ".join(
            str(n) for n in sorted({count_layers(insertion, layer_count_rule) for insertion in group})
        )
        depths = [insertion.depth for insertion in group]
        choices.append(
            f"{len(group)} in {medium} (layers {layers}; depths {min(depths):g} to {max(depths):g} mm)"
        )
    return "; ".join(choices) or "none"


def _require_known(kind: str, wanted: Iterable[str], known: Iterable[str]) -> None:
    names = set(known)
    unknown = [name for name in wanted if name not in names]
    if unknown:
        what = f"{kind} {', '.join(unknown)} is not in the dataset"
        expected = f"one of {join_names(sort_by_similarity(unknown[0], names)) or '(none)'}"
        raise ConfigError(what, expected=expected, fix="correct the selection")


MIN_GROUPS = 5  # least number of groups from which the scatter between groups is estimated


def group_independent(insertions: Sequence[str], specimens: Sequence[str]) -> tuple[str, ...]:
    """Return the group of each insertion: its specimen if there are enough specimens, else the insertion
    itself.

    Repeats in one specimen (one hole at several depths) are no independent observations; but where
    everything went into a few pieces, the insertions are all there is.
    """
    return tuple(specimens) if len(set(specimens)) >= MIN_GROUPS else tuple(insertions)


def find_repeats(dataset: Dataset) -> dict[str, tuple[str, int]]:
    """Return which insertions of a dataset are one insertion, measured at several depths, by their ids.

    Of each its specimen, and a number in it. They went into one of several specimens (`group_independent`, of
    one medium) with the bevel on the same side, to different depths, and from one place where that is known.
    A tip track is a whole insertion.
    """
    found: dict[str, tuple[str, int]] = {}
    for medium in dict.fromkeys(one.medium for one in dataset.insertions):
        into = [one for one in dataset.insertions if one.medium == medium and not isinstance(one, TipTrack)]
        if len({one.specimen for one in into}) < MIN_GROUPS:
            continue
        holes: list[list[Insertion]] = []
        for one in into:
            own = next((hole for hole in holes if _is_one_hole(dataset, hole, one)), None)
            if own is None:
                holes.append([one])
            else:
                own.append(one)
        for number, hole in enumerate(holes):
            found |= {one.id: (one.specimen, number) for one in hole if len(hole) > 1}
    return found


def list_bevels(dataset: Dataset, insertions: Sequence[Insertion]) -> tuple[tuple[str, int], ...]:
    """Return of each insertion which bevel it was made with: depths of one insertion have the same.

    A specimen and a number in it, as of `find_repeats`; the insertion's id and 0 where it has one depth.
    """
    repeats = find_repeats(dataset)
    return tuple(repeats.get(one.id, (one.id, 0)) for one in insertions)


def _is_one_hole(dataset: Dataset, hole: Sequence[Insertion], other: Insertion) -> bool:
    one = hole[0]
    return (
        one.specimen == other.specimen
        and one.side == other.side
        and all(part.depth != other.depth for part in hole)
        and (dataset.pose != "known" or np.array_equal(one.frame.rows, other.frame.rows))
    )
