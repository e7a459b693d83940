"""Propose the interfaces of layers that the brightness around the needle shows.

Soft material is sampled in a tube around the needle, without the needle's own bloom and without markers.
Where the median over the tube changes along the needle, a surface is fitted to all samples around that place:

    brightness = level of the sector + step * Phi((x - h(y, z)) / width)

x along the mean direction of the inserted needle, y and z across it; h is a plane with a curvature of less
than 1 / `MIN_RADIUS_MM` as a rule. The deviation of the place at which the needle crosses it comes from a
jackknife over the sectors: rays and neighbouring markers disturb some directions, noise all of them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.optimize import OptimizeResult, least_squares
from scipy.special import ndtr

from needlefit.arrays import Floats, Ints
from needlefit.geometry.curves import arc_length, interpolate_at_arc, make_normal
from needlefit.geometry.surfaces import Surface, make_grid_sheet
from needlefit.imaging.materials import BLUR_MM, MAX_GAP_HU, merge_levels, partition
from needlefit.imaging.reconstruction import ProposedInterface
from needlefit.imaging.volume import Volume, to_index

STATION_MM = 0.5  # distance of the samples along the needle, mm
# Radii at which the surroundings are sampled, mm: beyond bloom, near enough for a plane.
RADII_MM = (4.0, 5.5, 7.0, 8.5, 10.0, 11.5)
SECTORS, DIRECTIONS = 12, 24  # sectors of the jackknife, and directions around the needle that are sampled
# Brighter samples are markers or bone, HU; they are left out with `MARGIN_STATIONS` to both sides.
MAX_SOFT_HU = 300.0
MARGIN_STATIONS = 3
MIN_KNOWN_FRACTION = 0.3  # part of a section that must be soft material
# Least step of brightness, least length of a layer, and least scatter of the medians along the needle.
MIN_STEP_HU, MIN_LENGTH_MM, MIN_NOISE_HU = 15.0, 3.0, 4.0
WINDOW_MM = 6.0  # distance to both sides of an interface in which the surface is fitted, mm
MIN_RADIUS_MM = 40.0  # radius of curvature, mm, that one in three interfaces falls below
WIDTH_MM = 0.6  # blur of an interface, mm, known within a factor of e: a standard deviation
MIN_SIGNIFICANCE = 4.0  # least step of brightness over its jackknife deviation
MAX_SD_MM = 1.5  # interfaces that are known less well are not proposed, mm
SYSTEMATIC_SD_MM = 0.05  # deviation that no sector shows, mm
PATCH_RADIUS_MM = 15.0  # radius of the surface that is written, around the needle, mm


@dataclass(frozen=True)
class TubeSamples:
    """Soft material around the needle."""

    origin: Floats  # (3,); where the needle enters, LPS, mm
    axes: Floats  # (3, 3); rows: x, y, z, LPS
    x: Floats  # (n,); stations, mm from the entry
    across: Floats  # (n, c, 2); y and z of every sample, mm
    values: Floats  # (n, c); HU; nan where it is no soft material
    sector: Ints  # (c,)
    needle: Floats  # (n, 2); y and z of the needle itself, mm


def propose_layers(volume: Volume, needle: Floats, entry: float) -> tuple[ProposedInterface, ...]:
    """Return the interfaces between soft materials that the needle crosses behind its entry.

    `needle`: (N, 3); from base to tip, LPS, mm.
    `entry`: where it enters the tissue, mm along it.
    """
    samples = sample_tube(volume, needle, entry)
    kept = _fit_changes(samples, _find_changes(samples))
    return tuple(
        ProposedInterface(
            _make_patch(samples, one.surface, one.place, number),
            _to_arc(needle, entry, samples, one.place),
            one.sd,
            one.step,
            float(np.arctan(np.hypot(one.surface[1], one.surface[2]))),
        )
        for number, one in enumerate(kept, start=2)
    )


@dataclass(frozen=True)
class _Fitted:
    """An interface that was fitted: where the needle crosses it, x, mm, its deviation, step and surface."""

    place: float
    sd: float
    step: float
    surface: Floats


def _fit_changes(samples: TubeSamples, changes: list[float]) -> list[_Fitted]:
    """Return the interfaces at changes along the needle, mm, of which no two are one.

    A slanting interface may change the median twice. Of two that are nearer than a layer is thick the one
    that is known less well is left out, and all are fitted again.
    """
    tip = float(samples.x[-1]) - WINDOW_MM
    while changes:
        bounds = [float(samples.x[0]), *changes, float(samples.x[-1])]
        fitted = [_fit_interface(samples, at, (bounds[n], bounds[n + 2])) for n, at in enumerate(changes)]
        doubt = [
            MAX_SD_MM if one is None or not bounds[n] < one.place < min(bounds[n + 2], tip) else one.sd
            for n, one in enumerate(fitted)
        ]
        known = [one for one in fitted if one is not None]
        worst = int(np.argmax(doubt))
        if doubt[worst] < MAX_SD_MM:
            gaps = np.diff([one.place for one in known])
            close = np.flatnonzero(gaps < MIN_LENGTH_MM)
            if not len(close):
                return known
            worst = max((int(close[0]), int(close[0]) + 1), key=lambda n: doubt[n])
        # one at a time: without it the windows of its neighbours are wider
        changes = [at for n, at in enumerate(changes) if n != worst]
    return []


def sample_tube(volume: Volume, needle: Floats, entry: float) -> TubeSamples:
    """Return the soft material around the inserted needle."""
    s = arc_length(needle)
    begin, tip = interpolate_at_arc(needle, np.array([entry, s[-1]]))
    length = float(np.linalg.norm(tip - begin))
    first = (tip - begin) / length
    second = make_normal(first)
    axes = np.stack([first, second, np.cross(first, second)])
    x = np.arange(BLUR_MM, length + WINDOW_MM, STATION_MM)
    local = (needle - begin) @ axes.T
    order = np.argsort(local[:, 0])
    middle = np.column_stack([np.interp(x, local[order, 0], local[order, n]) for n in (1, 2)])
    angles = 2 * np.pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    ring = np.array([[r * np.cos(a), r * np.sin(a)] for r in RADII_MM for a in angles])
    across = middle[:, None] + ring
    points = begin + x[:, None, None] * first + across @ axes[1:]
    index = to_index(volume, points.reshape(-1, 3))[:, ::-1].T
    values = map_coordinates(volume.values, index, order=1, cval=np.nan, output=np.float64)
    values = values.reshape(across.shape[:2])
    sector = np.tile(np.arange(DIRECTIONS) * SECTORS // DIRECTIONS, len(RADII_MM))
    hard = ~((values > MAX_GAP_HU) & (values < MAX_SOFT_HU))
    near = hard.copy()
    for shift in range(1, MARGIN_STATIONS + 1):
        near[shift:] |= hard[:-shift]
        near[:-shift] |= hard[shift:]
    return TubeSamples(begin, axes, x, across, np.where(near, np.nan, values), sector, middle)


def _find_changes(samples: TubeSamples) -> list[float]:
    """Return where the median of the sections changes, x, mm."""
    known = np.isfinite(samples.values).mean(axis=1) >= MIN_KNOWN_FRACTION
    x = samples.x[known]
    least = int(MIN_LENGTH_MM / STATION_MM)
    if len(x) < 2 * least:
        return []
    middle = np.nanmedian(samples.values[known], axis=1)
    noise = max(MIN_NOISE_HU, 1.05 * float(np.median(np.abs(np.diff(middle)))))
    changes = merge_levels(middle, partition(middle, noise, least), MIN_STEP_HU)
    return [float(x[n - 1] + x[n]) / 2 for n in changes]


def _fit_interface(samples: TubeSamples, at: float, between: tuple[float, float]) -> _Fitted | None:
    """Return the interface at a change, fitted `between` its neighbours; None if none shows.

    Its surface: height on the axis, slopes along y and z, curvatures yy, yz, zz, mm.
    """
    near = (samples.x > max(between[0], at - WINDOW_MM)) & (samples.x < min(between[1], at + WINDOW_MM))
    values = samples.values[near]
    known = np.isfinite(values)
    x = np.broadcast_to(samples.x[near][:, None], values.shape)[known]
    y, z = (samples.across[near][..., n][known] for n in (0, 1))
    sector = np.broadcast_to(samples.sector, values.shape)[known]
    values = values[known]
    present, sector = np.unique(sector, return_inverse=True)
    if len(present) < SECTORS / 2:
        return None
    step = float(np.median(values[x > at]) - np.median(values[x <= at]))
    levels = [
        float(np.median(values[sector == n] - step * (x[sector == n] > at))) for n in range(sector.max() + 1)
    ]
    start = np.array([at, 0, 0, 0, 0, 0, np.log(WIDTH_MM), step, *levels])
    whole = _fit_surface((x, y, z, values, sector), start)
    crossing, step = _cross(whole.x, samples, at), float(whole.x[7])
    without = []
    for left_out in range(len(present)):
        keep = sector != left_out
        part = _fit_surface((x[keep], y[keep], z[keep], values[keep], sector[keep]), whole.x)
        without.append((_cross(part.x, samples, at), part.x[7]))
    count = len(without)
    spread = np.sqrt(
        (count - 1) / count * np.sum((np.array(without) - np.mean(without, axis=0)) ** 2, axis=0)
    )
    if abs(step) < MIN_SIGNIFICANCE * spread[1] or abs(step) < MIN_STEP_HU / 2:
        return None
    return _Fitted(crossing, float(np.hypot(spread[0], SYSTEMATIC_SD_MM)), step, whole.x[:6])


def _fit_surface(data: tuple[Floats, Floats, Floats, Floats, Ints], start: Floats) -> OptimizeResult:
    x, y, z, values, sector = data
    scatter = values - start[8:][sector] - start[7] * ndtr((x - start[0]) / WIDTH_MM)
    noise = max(1.0, 1.48 * float(np.median(np.abs(scatter - np.median(scatter)))))

    def residuals(theta: Floats) -> Floats:
        height = _height(theta, y, z)
        shown = theta[8:][sector] + theta[7] * ndtr((x - height) / np.exp(theta[6]))
        bent = theta[3:6] * 2 * MIN_RADIUS_MM
        return np.concatenate([(shown - values) / noise, bent, [theta[6] - np.log(WIDTH_MM)]])

    scale = np.concatenate([[0.3, 0.03, 0.03, 0.005, 0.005, 0.005, 0.3, 10.0], np.full(len(start) - 8, 10.0)])
    return least_squares(residuals, start, loss="soft_l1", x_scale=scale, ftol=1e-5, max_nfev=50)


def _height(theta: Floats, y: Floats, z: Floats) -> Floats:
    curved = theta[3] * y**2 + theta[4] * y * z + theta[5] * z**2
    return np.asarray(theta[0] + theta[1] * y + theta[2] * z + curved)


def _cross(theta: Floats, samples: TubeSamples, at: float) -> float:
    """Return the x at which the needle crosses the surface, mm."""
    place = at
    for _ in range(5):  # the needle is nearly parallel to x
        y, z = (np.interp([place], samples.x, samples.needle[:, n]) for n in (0, 1))
        place = float(_height(theta, y, z)[0])
    return place


def _to_arc(needle: Floats, entry: float, samples: TubeSamples, place: float) -> float:
    """Return the arc length from the entry at which the needle reaches x = `place`, mm."""
    s = arc_length(needle)
    inside = s >= entry
    x = (needle[inside] - samples.origin) @ samples.axes[0]
    return float(np.interp(place, x, s[inside] - entry))


def _make_patch(samples: TubeSamples, theta: Floats, place: float, into: int) -> Surface:
    """Return the surface within `PATCH_RADIUS_MM` of the needle, LPS."""
    y0, z0 = (np.interp(place, samples.x, samples.needle[:, n]) for n in (0, 1))
    steps = np.linspace(-PATCH_RADIUS_MM, PATCH_RADIUS_MM, 21)
    y, z = np.meshgrid(y0 + steps, z0 + steps, indexing="ij")
    local = np.stack([_height(theta, y, z), y, z], axis=-1)
    return make_grid_sheet(f"proposed{into}", samples.origin + local @ samples.axes, into)
