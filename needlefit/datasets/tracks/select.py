"""Which runs of a dataset of tip tracks a study means."""

from needlefit.datasets.tracks.track import Track, TrackDataset
from needlefit.errors import ConfigError
from needlefit.project.locate import join_names, sort_by_similarity
from needlefit.schemas.study import TrackSelectionRecord


def select_runs(dataset: TrackDataset, wanted: TrackSelectionRecord) -> tuple[Track, ...]:
    """Return the runs that meet every key of `wanted`, in the dataset's order.

    Raises
    ------
    ConfigError
        If a medium or run is unknown, or none is left.
    """
    for kind, names, known in (
        ("medium", wanted.media, dataset.media),
        ("run", wanted.runs, tuple(track.id for track in dataset.tracks)),
    ):
        for name in names:
            if name not in known:
                raise ConfigError(
                    f"{kind} {name} is not in dataset {dataset.name}, or is left out",
                    expected=f"one of {join_names(sort_by_similarity(name, known))}",
                    fix="correct the selection",
                )
    chosen = tuple(track for track in dataset.tracks if _meets(track, wanted))
    if not chosen:
        raise ConfigError(
            f"no run of dataset {dataset.name} meets {wanted.model_dump(exclude_defaults=True)}",
            expected="a selection that leaves at least one",
            fix="widen or correct the selection",
        )
    return chosen


def _meets(track: Track, wanted: TrackSelectionRecord) -> bool:
    return (
        (not wanted.media or track.medium in wanted.media)
        and (not wanted.runs or track.id in wanted.runs)
        and (wanted.guided is None or track.guided == wanted.guided)
    )
