"""Score how well one method predicts the readings of one run."""

from collections.abc import Iterator, Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.geometry.frames import make_tracker_columns
from needlefit.inference.likelihood.observation import Observation
from needlefit.inference.predict import (
    INTERVAL_PROBABILITIES,
    PredictiveMixture,
    crps,
    interval,
    quantile,
    simulate_shape_pit,
)
from needlefit.inference.tracking import TrackDraws, estimate_slopes, predict_readings
from needlefit.studies.score import Row


def tabulate_tuned(tuned: Sequence[Observation], drawn: TrackDraws) -> Iterator[Row]:
    """Yield the residuals of a method on the runs that it was fitted to."""
    for track, deflection in zip(_tracks(tuned), drawn.tuned, strict=True):
        yield {**_describe_track(track, len(track.tip)), **_aligned_error(track, deflection, 0)}


def predict_runs(
    tuned: Sequence[Observation],
    held: Sequence[Observation],
    drawn: TrackDraws,
    placed_by: float,
    rng: np.random.Generator,
) -> Iterator[tuple[Row, list[Row]]]:
    """Yield for every held-out run its scores, and its readings beside their predictions."""
    for track, known, deflection in zip(_tracks(held), held, drawn.held_out, strict=True):
        placed, slope = count_registration_readings(track, placed_by), estimate_slopes(drawn, tuned, track)
        draws = predict_readings(known, deflection, drawn.scale, slope, placed, rng)
        mixture = PredictiveMixture(draws, np.zeros(draws.shape[1]))
        row = _describe_track(track, draws.shape[1]) | _aligned_error(track, deflection, placed)
        row |= _score_prediction(mixture, track.tip[placed:], rng)
        yield row, list(_reading_rows(track, mixture, placed))


def _tracks(observations: Sequence[Observation]) -> list[TipTrack]:
    return [one.insertion for one in observations if isinstance(one.insertion, TipTrack)]


def count_registration_readings(track: TipTrack, placed_by: float) -> int:
    """Return how many readings of a run locate it in the tracker's frame; the others are scored."""
    return max(1, int(np.sum(track.depths <= placed_by)))


def _describe_track(track: TipTrack, readings: int) -> Row:
    return {"run": track.id, "medium": track.medium, "specimen": track.specimen, "readings": readings}


def _aligned_error(track: TipTrack, deflection: Floats, placed: int) -> Row:
    """Return what is left between the scored readings and the draws, shift and slope taken from all alike."""
    off = (track.tip - deflection)[:, placed:]  # (B, m)
    taken = np.linalg.qr(make_tracker_columns(track.depths[placed:]))[0]
    left = np.median(off - off @ taken @ taken.T, axis=0)
    return {"aligned_rms_mm": float(np.sqrt(np.mean(left**2)))}


def _score_prediction(mixture: PredictiveMixture, measured: Floats, rng: np.random.Generator) -> Row:
    off = quantile(mixture, 0.5) - measured
    level = simulate_shape_pit(mixture, np.zeros((len(measured), len(measured))), measured, rng)
    row: Row = {"rms_mm": float(np.sqrt(np.mean(off**2))), "end_error_mm": float(off[-1])}
    row |= {"crps_mm": float(crps(mixture, measured).mean()), "track_pit": level}
    for wanted in INTERVAL_PROBABILITIES:
        name = f"{100 * wanted:.0f}"
        low, high = interval(mixture, wanted)
        within = (low <= measured) & (measured <= high)
        row |= {f"end_in_{name}": bool(within[-1]), f"points_in_{name}": float(within.mean())}
        row |= {f"track_in_{name}": level <= wanted, f"end_width_{name}_mm": float(high[-1] - low[-1])}
    return row


_INTERVAL_KEYS = ("low_", "high_", "crps_", "track_", "end_in_", "end_width_", "points_in_")


def remove_intervals(row: Row) -> Row:
    """Return a row without what only certified draws can predict: intervals and the scores of these."""
    return {key: np.nan if key.startswith(_INTERVAL_KEYS) else value for key, value in row.items()}


def _reading_rows(track: TipTrack, mixture: PredictiveMixture, placed: int) -> Iterator[Row]:
    predicted = {"median_mm": quantile(mixture, 0.5)}
    for level in INTERVAL_PROBABILITIES:
        low, high = interval(mixture, level)
        predicted |= {f"low_{100 * level:.0f}_mm": low, f"high_{100 * level:.0f}_mm": high}
    first = track.tip[0]
    for n, (depth, guide, tip) in enumerate(zip(track.depths, track.guide, track.tip, strict=True)):
        known = {
            name: float(of[n - placed] - first) if n >= placed else np.nan for name, of in predicted.items()
        }
        about = {"depth_mm": float(depth), "guide_mm": float(guide), "scored": n >= placed}
        yield {"run": track.id, "medium": track.medium, **about, "measured_mm": float(tip - first), **known}
