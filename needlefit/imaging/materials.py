"""Sample the brightness along the needle, and explain it as runs of air, soft material and metal.

Soft is what lies between air and metal: tissue, a gel, the plastic of a guide or of a hub.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import binary_dilation, binary_opening
from scipy.optimize import curve_fit
from scipy.signal import find_peaks
from scipy.special import ndtr, ndtri

from needlefit.arrays import Floats, Ints
from needlefit.imaging.constants import HU, MM, PART, PROBABILITY, SCANNER, SD
from needlefit.imaging.needle.axis_spline import (
    PLANE_SPACING_MM,
    correlation_factor,
    disc_points,
    frames_along,
    sample_planes,
)
from needlefit.imaging.reconstruction import IntensityProfile, MaterialKind, MaterialRun
from needlefit.imaging.volume import Volume

RING = disc_points(MM.RING[1])  # (N, 2); its points, mm
RING = RING[np.hypot(*RING.T) >= MM.RING[0]]  # points of the ring (mm), (N, 2)


def sample_profile(volume: Volume, points: ArrayLike, s: ArrayLike) -> IntensityProfile:
    """Return the brightness of the needle and of its surroundings at each station.

    The surroundings are the median of a ring: rays, which fill a part of it, do not count. Points outside the
    volume and on markers are left out, with those opposite. Where most of the ring is metal, it is a hub or a
    holder, and its brightness is returned.

    `points`: (N, 3); along the needle, LPS, mm; what lies beyond its tip is welcome.
    `s`: (N,); where along the needle they are, mm.
    """
    where = frames_along(np.asarray(points, dtype=np.float64))
    ring = sample_planes(volume, where, RING)
    metal = _row_medians(ring, PART.SHOWN)
    ring = np.where(ring < HU.METAL, ring, np.nan)
    ring = np.where(np.isfinite(ring[:, ::-1]), ring, np.nan)  # the same disc, turned round
    core = sample_planes(volume, where, disc_points(PLANE_SPACING_MM))
    around = np.where(metal > HU.METAL, metal, _row_medians(ring, PART.SHOWN))
    return IntensityProfile(np.asarray(s, dtype=np.float64), _row_medians(core, 1.0), around)


def _row_medians(values: Floats, least: float) -> Floats:
    """Return the median (N,) of each row's known values; nan where fewer than the part `least` is known."""
    enough = np.isfinite(values).mean(axis=1) >= least
    middle = np.full(len(values), np.nan)
    if enough.any():
        middle[enough] = np.nanmedian(values[enough], axis=1)
    return middle


def find_runs(profile: IntensityProfile, least: float = MM.BLUR_REACH) -> tuple[MaterialRun, ...]:
    """Return the runs of air, soft material and metal around the needle, from its base to its tip.

    What is shorter than `least`, mm, or than blur makes it belongs to its neighbours.
    """
    s, values = _known_stations(profile)
    if len(s) < 8:
        return ()
    step = float(np.median(np.diff(s)))
    kinds = np.where(values > HU.METAL, 2, np.where(values < HU.GAP, 0, 1))
    foam = np.ones(1 + round(2 * MM.BLUR_REACH / step), bool)  # what is shorter is blur
    kinds[binary_opening((values > HU.LIGHT) & (kinds == 0), foam)] = 1
    bloom = np.ones(1 + 2 * round(MM.BLUR_REACH / step), bool)
    kinds[binary_dilation(kinds == 2, bloom) & (kinds == 1)] = 2
    kinds = _absorb_short_runs(kinds, step, least)
    ends = np.flatnonzero(np.diff(kinds)) + 1
    names: tuple[MaterialKind, ...] = ("air", "soft", "metal")
    parts = [names[kinds[n]] for n in (0, *ends)]
    levels = [float(np.median(part)) for part in np.split(values, ends)]
    between = [float(s[at - 1] + s[at]) / 2 for at in ends]
    bounds = [float(s[0]), *between, float(s[-1])]
    return tuple(map(MaterialRun, parts, bounds[:-1], bounds[1:], levels))


def _known_stations(profile: IntensityProfile) -> tuple[Floats, Floats]:
    """Return stations (n,) before the tip with known surroundings, and these (n,)."""
    known, shown = np.isfinite(profile.around), np.isfinite(profile.core)
    if shown.any():  # beyond the needle's end nothing is entered by it
        bright = profile.s[shown & (profile.core > np.nanmedian(profile.core) / 2)]
        known &= profile.s <= max(bright, default=np.inf) + 1e-6
    return profile.s[known], profile.around[known]


def _absorb_short_runs(kinds: Ints, step: float, shortest: float) -> Ints:
    """Return kinds (n,) in which every run is long enough; the shortest is given to its neighbours first."""
    kinds = kinds.copy()
    while True:
        begins = np.concatenate([[0], np.flatnonzero(np.diff(kinds)) + 1])
        lengths, least = np.diff(begins, append=len(kinds)), np.full(len(begins), shortest)
        least[1:-1][kinds[begins[1:-1]] == 0] = MM.BLUR_CORE
        # to the nearest station: those of a curve are not exactly as far apart as stated
        short = np.flatnonzero(lengths < np.rint(least / step))
        if not len(short) or len(begins) == 1:
            return kinds
        n = int(short[np.argmin(lengths[short])])
        longer = max((m for m in (n - 1, n + 1) if 0 <= m < len(begins)), key=lambda m: int(lengths[m]))
        kinds[begins[n] : begins[n] + lengths[n]] = kinds[begins[longer]]


@lru_cache(maxsize=4)  # asked for again for entry, materials and warnings
def find_rises(
    profile: IntensityProfile, least: float = MM.BLUR_REACH
) -> tuple[tuple[int, float, float], ...]:
    """Return every place where air turns into soft material: the run that begins, mm and its deviation."""
    runs = find_runs(profile, least)
    rising = [n for n in range(1, len(runs)) if (runs[n - 1].kind, runs[n].kind) == ("air", "soft")]
    return tuple((n, *edge) for n in rising if (edge := _fit_edge(profile, runs, n)) is not None)


def _fit_edge(
    profile: IntensityProfile, runs: tuple[MaterialRun, ...], target: int
) -> tuple[float, float] | None:
    """Return where run `target` begins, mm, and its deviation; None if nothing rises there.

    An error function from air to soft material, with a slope behind it for a hardened beam, is fitted to the
    median around the needle, as far as the blur of no other edge reaches. The blurred air of a narrow gap
    shows no level: air has its own.
    """
    s, values = _known_stations(profile)
    gap, guess, step = runs[target - 1], runs[target].begin, float(np.median(np.diff(s)))
    narrow = target > 1 and gap.length < 2 * MM.BLUR_REACH
    clear = min(MM.EDGE_BLUR, gap.length / 2) if target > 1 else 0.0
    reach = 4 * MM.BLUR_REACH
    before = max(guess - reach, gap.begin + clear)
    ends = [run.end for run in runs[target:-1]][:1] + [at for at in find_steps(profile) if at > guess]
    after = max(guess + MM.EDGE_BLUR, min([guess + reach, *(at - MM.MATCH for at in ends)]))
    near = (s >= before) & (s <= after)
    s, values = s[near], values[near]
    air, soft = values[s < guess], values[s >= guess]
    if not len(air) or len(soft) * step < MM.BLUR_CORE:
        return None
    low, high = HU.AIR if narrow else float(np.median(air)), float(np.median(soft))
    if high - low < HU.METAL_CONTRAST:
        return None

    def show(s: Floats, at: float, width: float, low: float, high: float, slope: float) -> Floats:
        return low + (high - low + slope * np.clip(s - at, 0, None)) * ndtr((s - at) / width)

    first = np.array([guess, SCANNER.BLUR.value, low, high, 0.0])
    margin = np.array([MM.EDGE_BLUR, np.inf, HU.STEP if narrow else np.inf, np.inf, np.inf])
    bounds = first - margin, first + margin
    bounds[0][1], bounds[1][1] = SCANNER.SLICE_BLUR.range
    noise = max(1.0, 1.05 * float(np.median(np.abs(np.diff(values)))))  # HU are whole numbers
    best, covariance = curve_fit(
        show,
        s,
        values,
        first,
        np.full(len(s), noise),
        bounds=bounds,
        loss="soft_l1",
        f_scale=SD.OUTLIER,
        x_scale="jac",
        ftol=1e-6,
        xtol=1e-6,
    )
    left = values - show(s, *best)
    variance = covariance[0, 0] * correlation_factor(left[:, None], len(best))
    # an edge sharper than the stations are dense leaves no slope: it lies between two, where the misfit
    # in parts of its height says
    sd = np.sqrt(variance)
    if best[1] < step:
        sd = min(sd, step * np.sqrt(np.mean(left**2)) / (best[3] - best[2]))
    return float(best[0]), float(np.hypot(min(sd, max(step, best[1]) / np.sqrt(12)), MM.EDGE_SD))


@lru_cache(maxsize=2)
def find_steps(profile: IntensityProfile) -> tuple[float, ...]:
    """Return the places inside soft material where its brightness changes, mm, from the base on."""
    s, values = _known_stations(profile)
    runs, found = find_runs(profile), list[float]()
    for n, run in enumerate(runs):
        low = run.begin + MM.MATCH * (n > 0)
        high = run.end - MM.MATCH * (n < len(runs) - 1)
        inside = (s >= low) & (s <= high)
        if run.kind == "soft" and inside.any() and np.ptp(s[inside]) >= MM.EDGE_BLUR:
            found += _find_steps_within(s[inside], values[inside])
    return tuple(found)


def _find_steps_within(s: Floats, values: Floats) -> list[float]:
    """Return the steps of soft material at stations `s` (n,), the most significant of neighbours."""
    places = np.arange(s[0] + MM.BLUR_CORE, s[-1] - MM.BLUR_CORE, np.median(np.diff(s)) / 2)
    changes, sds, alike = np.array([_fit_step(s, values, place) for place in places]).reshape(-1, 3).T
    clear = np.abs(changes) / np.maximum(sds, 1e-9)
    sure = clear / np.sqrt(alike)  # the scatter of a sum of correlated stations, where it is clearest
    # of noise alone none of the places shows a step, but for that probability
    least = -ndtri(PROBABILITY.FALSE_ALARM / 2 / len(places))
    shown = np.where((np.abs(changes) >= HU.STEP) & (sure >= least), clear, 0.0)
    apart = 2 * MM.EDGE_BLUR / np.median(np.diff(s))
    return places[find_peaks([0.0, *shown, 0.0], distance=1 + apart)[0] - 1].tolist()


def _fit_step(s: Floats, values: Floats, place: float) -> tuple[float, float, float]:
    """Return the change at a place on a common slope, its deviation, HU, and how many stations are as one."""
    near = np.abs(s - place) <= 2 * MM.EDGE_BLUR
    x, y = s[near] - place, values[near]
    design = np.stack([np.ones(len(x)), x, ndtr(x / SCANNER.BLUR.value)], axis=1)
    inverse = np.linalg.pinv(design)
    left = y - design @ (inverse @ y)
    sd = np.linalg.norm(left) / np.sqrt(max(1, len(x) - 3)) * np.linalg.norm(inverse[2])
    return float(inverse[2] @ y), float(sd), correlation_factor(left[:, None], 3)


def list_materials(profile: IntensityProfile, tip: float) -> Iterator[MaterialRun]:
    """Yield what the needle passes, from its base to its `tip`, mm: runs, and the parts of soft ones."""
    s, values = _known_stations(profile)
    runs, rises = find_runs(profile), {n: at for n, at, _ in find_rises(profile)}
    begins = [rises.get(n, run.begin) for n, run in enumerate(runs)]
    steps = find_steps(profile)
    for run, begin, end in zip(runs, begins, [*begins[1:], tip][: len(runs)], strict=True):
        for low, high in pairwise([begin, *(at for at in steps if begin < at < end), end]):
            part = values[(s >= low) & (s <= high)]
            yield MaterialRun(run.kind, low, high, float(np.median(part)) if len(part) else run.level)
