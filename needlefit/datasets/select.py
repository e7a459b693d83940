"""Select the insertions of a dataset for a fit or a study, and group insertions that are not independent."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Literal, TypeVar

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.errors import ConfigError
from needlefit.mechanics.needle import Needle
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
    insertions = dataset.insertions
    with add_key_context(f"{key}.medium"):
        _require_known("medium", _list_media(selection) or (), dataset.media)
    with add_key_context(f"{key}.specimens"):
        _require_known(
            "specimen", selection.specimens or (), {insertion.specimen for insertion in insertions}
        )
    with add_key_context(f"{key}.insertions"):
        _require_known("insertion", selection.insertions or (), {insertion.id for insertion in insertions})
    chosen = tuple(insertion for insertion in insertions if _matches(insertion, selection, layer_count_rule))
    if not chosen:
        given = ", ".join(
            f"{name} = {value}" for name, value in selection.model_dump(exclude_none=True).items()
        )
        raise ConfigError(
            f"no insertion of dataset {dataset.name} has {given}",
            expected=f"some of its {len(insertions)} insertions",
            fix="widen or correct the selection",
            key=key,
        )
    return chosen


_I = TypeVar("_I", bound=Insertion)


def select_same_needle(insertions: Sequence[_I], needle: Needle, least: int = 1) -> tuple[_I, ...]:
    """Return the insertions of a needle, or, where fewer than `least` are, all: curves differ by needle."""
    same = tuple(insertion for insertion in insertions if insertion.needle == needle)
    return same if len(same) >= least else tuple(insertions)


def count_layers(insertion: Insertion, layer_count_rule: LayerCountRule) -> int:
    """Return the number of layers that an insertion traverses, counted by the given rule."""
    return insertion.layers if layer_count_rule == "listed" else insertion.layers_alternative


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
            selection.guided is None or (insertion.guide is not None and insertion.guided == selection.guided)
        )
    )


def _list_media(selection: SelectionRecord) -> tuple[str, ...]:
    wanted = selection.medium
    return (wanted,) if isinstance(wanted, str) else (wanted or ())


def _require_known(kind: str, wanted: Iterable[str], available: Iterable[str]) -> None:
    names = set(available)
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise ConfigError(
            f"{kind} {', '.join(unknown)} is not in the dataset",
            expected=f"one of {join_names(sort_by_similarity(unknown[0], names)) or '(none)'}",
            fix="correct the selection",
        )


MIN_GROUPS = 5  # smallest number of groups from which the scatter between groups is estimated
ENTRY_DECIMALS = 3  # decimals to which places (mm) and unit directions of one entry agree


def group_independent(holes: Sequence[str], specimens: Sequence[str]) -> tuple[str, ...]:
    """Return the group of each insertion: its specimen if there are enough specimens, else its hole.

    Several depths of one hole (`name_holes`) are no independent observations. Nor are holes in one specimen;
    but where everything went into a few specimens, the holes are all there is.
    """
    return tuple(specimens if len(set(specimens)) >= MIN_GROUPS else holes)


def group_rows(table: pd.DataFrame) -> tuple[str, ...]:
    """Return the independent group of each row of a table of results."""
    return group_independent(list(table["hole"]), list(table["specimen"]))


HoleSource = Literal["stated", "entry", "assumed", "separate"]
"""How the insertions of a medium were divided into holes: by their column `hole`, by the entry pose, by
specimen and bevel side, or not at all."""


def find_hole_source(dataset: Dataset, medium: str) -> HoleSource:
    """Return how the insertions of a medium are divided into holes; all by the column where a row has it."""
    into = [insertion for insertion in dataset.insertions if insertion.medium == medium]
    if any(insertion.hole for insertion in into):
        return "stated"
    if all(insertion.in_tracker_frame for insertion in into):
        return "separate"
    if dataset.pose == "known":
        return "entry"
    # in a few specimens, separate insertions to different depths would be joined
    return "assumed" if len({insertion.specimen for insertion in into}) >= MIN_GROUPS else "separate"


def find_repeats(dataset: Dataset) -> dict[str, tuple[str, int]]:
    """Return which insertions of a dataset are one insertion, measured at several depths, by their ids.

    Of each its specimen, and a number in it. They have the same `hole` where the medium states it. Else they
    went into one specimen with the bevel on the same side and the same turns, to different depths, and, where
    the pose is known, from the same entry in the same direction. A tip track is a whole insertion, unless it
    has the hole of a shape: both were then measured of one.
    """
    repeats: dict[str, tuple[str, int]] = {}
    for medium in dict.fromkeys(insertion.medium for insertion in dataset.insertions):
        source = find_hole_source(dataset, medium)
        holes, count = dict[object, list[Insertion]](), Counter[object]()
        for insertion in (insertion for insertion in dataset.insertions if insertion.medium == medium):
            key = _make_hole_key(source, insertion)
            # another insertion that is as deep is another hole
            turn = 0 if source == "stated" else count[key, insertion.depth]
            holes.setdefault((key, turn), []).append(insertion)
            count[key, insertion.depth] += 1
        for number, hole in enumerate(holes.values()):
            repeats |= {insertion.id: (insertion.specimen, number) for insertion in hole if len(hole) > 1}
    return repeats


def _make_hole_key(source: HoleSource, insertion: Insertion) -> tuple[object, ...]:
    """Return what insertions of one hole have in common."""
    if source == "stated" and insertion.hole:
        return (insertion.specimen, insertion.hole)
    if source in ("stated", "separate") or insertion.in_tracker_frame:
        return (insertion.id,)
    entry = np.concatenate([insertion.frame.origin, insertion.frame.rotation[:, 0]]).round(ENTRY_DECIMALS)
    # adding 0 makes -0 the same as 0
    return (
        insertion.specimen,
        insertion.side,
        insertion.turns,
        *((entry + 0.0).tolist() if source == "entry" else ()),
    )


def name_holes(dataset: Dataset) -> dict[str, str]:
    """Return the hole of each insertion of a dataset, by ids: the id of the first insertion into it."""
    first: dict[tuple[str, int], str] = {}
    bevels = zip(dataset.insertions, list_bevels(dataset, dataset.insertions), strict=True)
    return {insertion.id: first.setdefault(bevel, insertion.id) for insertion, bevel in bevels}


def group_insertions(dataset: Dataset, insertions: Sequence[Insertion]) -> tuple[str, ...]:
    """Return the independent group of some insertions of a dataset, as `group_independent`."""
    holes = name_holes(dataset)
    own_holes = [holes.get(insertion.id, insertion.id) for insertion in insertions]
    return group_independent(own_holes, [insertion.specimen for insertion in insertions])


def list_bevels(dataset: Dataset, insertions: Sequence[Insertion]) -> tuple[tuple[str, int], ...]:
    """Return of each insertion which bevel it was made with: depths of one insertion have the same.

    A specimen and a number in it, as of `find_repeats`; the insertion's id and 0 where it has one depth.
    """
    repeats = find_repeats(dataset)
    return tuple(repeats.get(insertion.id, (insertion.id, 0)) for insertion in insertions)
