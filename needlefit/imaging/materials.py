"""Sample the brightness along the needle, and explain it as runs of air, soft material and metal.

Soft is what lies between air and metal: tissue, a gel, the plastic of a guide or of a hub.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import curve_fit
from scipy.signal import find_peaks
from scipy.special import ndtr, ndtri

from needlefit.arrays import Floats
from needlefit.imaging.constants import HU, MM, PART, PROBABILITY, SCANNER
from needlefit.imaging.needle.axis_spline import correlation_factor, disc_points, frames_along, sample_planes
from needlefit.imaging.reconstruction import EntryPlace, IntensityProfile, MaterialKind, MaterialRun
from needlefit.imaging.volume import Volume

RING = disc_points(MM.RING[1])  # (N, 2); its points, mm
RING = RING[np.hypot(*RING.T) >= MM.RING[0]]  # points of the ring (mm), (N, 2)
SAMPLES = 4  # of the brightness for each station, interpolated: so many count as one


def sample_profile(volume: Volume, points: ArrayLike, s: ArrayLike) -> IntensityProfile:
    """Return the brightness around the needle at each station.

    The surroundings are the median of a ring: rays, which fill a part of it, do not count. Points outside the
    volume and on markers are left out, with those opposite. Where most of the ring is metal, it is a hub or a
    holder, and its brightness is returned.

    `points`: (N, 3); along the needle, LPS, mm; what lies beyond its tip is welcome.
    `s`: (N,); where along the needle they are, mm.
    """
    where = frames_along(np.asarray(points, dtype=np.float64))
    ring = sample_planes(volume, where, RING)
    metal = _row_medians(ring)
    ring = np.where(ring < HU.METAL, ring, np.nan)
    ring = np.where(np.isfinite(ring[:, ::-1]), ring, np.nan)  # the same disc, turned round
    around = np.where(metal > HU.METAL, metal, _row_medians(ring))
    return IntensityProfile(np.asarray(s, dtype=np.float64), around)


def _row_medians(values: Floats) -> Floats:
    """Return the median (N,) of each row's known values; nan where these are too few."""
    enough = np.isfinite(values).mean(axis=1) >= PART.SHOWN
    middle = np.full(len(values), np.nan)
    if enough.any():
        middle[enough] = np.nanmedian(values[enough], axis=1)
    return middle


def list_materials(profile: IntensityProfile, tip: float) -> tuple[MaterialRun, ...]:
    """Return what the needle passes from its base to its `tip`, mm: runs of about one brightness.

    A run begins where the brightness along the needle changes fastest: a streak, which fades slowly, begins
    none.
    """
    visible = np.isfinite(profile.around) & (profile.s <= tip)
    if np.count_nonzero(visible) < 2:
        return ()
    first, *_, last = profile.s[visible].tolist()
    s = np.arange(first, last, MM.STATION / SAMPLES)
    values = np.interp(s, profile.s[visible], profile.around[visible])
    places, rises = _find_changes(s, values)
    levels = [float(np.median(part)) for part in np.split(values, np.searchsorted(s, places))]
    ends, edges = [-np.inf, *places.tolist(), np.inf], list[tuple[float, float]]()
    for n, rise in enumerate(rises.tolist(), start=1):
        metal = abs(rise) >= 2 * HU.METAL  # its face is no error function
        edges.append((ends[n], MM.HIDDEN_FACE_SD) if metal else _fit_edge(s, values, *ends[n - 1 : n + 2]))
    begins, sds = zip((first, 0.0), *edges, strict=True)
    runs = list[MaterialRun]()
    for begin, end, level, sd, rise in zip(
        begins, (*begins[1:], tip), levels, sds, (0.0, *rises.tolist()), strict=True
    ):
        # blur brightens the air of a narrow gap; foam and lung are no air
        air = HU.GAP if end - begin < 2 * MM.BLUR_REACH else HU.LIGHT
        kind: MaterialKind = "metal" if level > HU.METAL else "air" if level < air else "soft"
        # near metal streaks brighten air
        bright = rise >= HU.METAL_CONTRAST and any(run.kind == "metal" for run in runs)
        behind_air = bool(runs) and kind == "soft" and (runs[-1].kind == "air" or bright)
        runs.append(MaterialRun(kind, begin, end, level, sd, rise, behind_air))
    return tuple(runs)


def cut_runs(runs: Sequence[MaterialRun], entry: EntryPlace) -> tuple[MaterialRun, ...]:
    """Return runs of which one begins at an entry: the nearest change moves there, or a run is cut."""
    nearest = min((run.begin for run in runs), key=lambda begin: abs(begin - entry.at))
    moved = {nearest: entry.at} if abs(nearest - entry.at) <= MM.MATCH else {}
    parts = list[MaterialRun]()
    for run in runs:
        sd = entry.sd if run.begin in moved else run.sd
        part = replace(run, begin=moved.get(run.begin, run.begin), end=moved.get(run.end, run.end), sd=sd)
        if part.begin < entry.at < part.end:  # behind the cut the brightness is the same
            parts.append(replace(part, end=entry.at))
            part = replace(part, begin=entry.at, sd=entry.sd, rise=0.0, behind_air=False)
        parts.append(part)
    return tuple(parts)


def _find_changes(s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return where values (n,) at stations `s` (n,) change fastest, mm (m,), and by how much, HU (m,)."""
    step, width = float(s[1] - s[0]), SCANNER.BLUR.value
    slope = gaussian_filter1d(values, width / step, order=1, mode="nearest") / step
    noise = np.median(np.abs(slope)) / ndtri(0.75)
    # as steep as the least change is after blur and filter, and steeper than noise is anywhere
    least = max(HU.STEP / (width * np.sqrt(4 * np.pi)), noise * -ndtri(PROBABILITY.FALSE_ALARM / 2 / len(s)))
    apart = round(MM.MATCH / step)
    near = round(MM.BLUR_CORE / step)  # within it the larger change counts: a kernel overshoots
    steepest = find_peaks(np.abs(slope), least, distance=near, prominence=least)[0]
    steepest = steepest[(steepest >= apart) & (steepest < len(s) - apart)]
    middles = np.array([0, *(steepest[1:] + steepest[:-1]) // 2, len(s) - 1])
    before = values[np.maximum(steepest - apart, middles[:-1])]
    behind = values[np.minimum(steepest + apart, middles[1:])]
    places, rises = s[steepest], behind - before
    use = np.abs(rises) >= HU.STEP
    return places[use], rises[use]


def _fit_edge(s: Floats, values: Floats, last: float, place: float, following: float) -> tuple[float, float]:
    """Return where values (n,) at stations `s` (n,) change about `place`, and its deviation, mm.

    An error function is fitted as far as neither the `last` nor the `following` change, mm, is nearer. The
    blurred air of a narrow gap shows no level: air has its own.
    """

    def show(s: Floats, middle: float, width: float, before: float, behind: float) -> Floats:
        return before + (behind - before) * ndtr((s - middle) / width)

    reach, air = 2 * MM.BLUR_REACH, min(HU.AIR, values.min())
    near = (np.abs(s - place) <= reach) & (s > (last + place) / 2) & (s < (place + following) / 2)
    s, values = s[near], values[near]
    darkest = air + HU.STEP if place - last < reach and values[0] < HU.GAP else np.inf
    before, behind = (float(np.median(values[side])) for side in (s <= place, s >= place))
    widths = SCANNER.BLUR.range[0], SCANNER.SLICE_BLUR.range[1]
    best, covariance = curve_fit(
        show,
        s,
        values,
        [place, SCANNER.BLUR.value, min(before, darkest), behind],
        bounds=([s[0], widths[0], air, air], [s[-1], widths[1], darkest, np.inf]),
        x_scale="jac",
        ftol=PART.TOLERANCE,
        xtol=PART.TOLERANCE,
    )
    alike = correlation_factor((values - show(s, *best))[:, None], SAMPLES * len(best))
    sd = min(np.sqrt(covariance[0, 0] * alike), max(MM.STATION, best[1]) / np.sqrt(12))
    return float(best[0]), float(np.hypot(sd, MM.MODEL_SD))
