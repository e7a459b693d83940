"""Find the needle's tip: fit the image of a bevelled rod to the voxels around the end, and check it.

A scanner shows the rod times its modulation transfer (`point_spread`). Coordinates are the needle's: s along
it from the tip, u and v across.

What the end, and its thin bevel, fill in part is darker than in proportion: the detector averages intensities
over a cell and a slice, not their logarithms (G. H. Glover and N. J. Pelc, Med. Phys. 7 (1980) 238-248).
Without that, ten tips of needles across or oblique to slices of 0.6 to 2 mm were 0.10 mm short in the mean,
with it 0.01; for the slice alone 0.07. Of eight scans whose voxels average attenuations, as no scanner's do,
tips are 0.09 mm too far with it, 0.05 without.

Blur, overshoot, the slices' blur and the metal's height are fitted with the tip, held by what balls in the
scan show of them and by what metal and scanners can have. So is the dark streak that rays along the shaft
leave beyond its end.

What errs is the model, hardly the noise. Of 21 volumes of two renderers errors along the needle over their
deviations were (root mean square) 9.5 by the scatter of four fits to the fitted image with the scan's noise,
which took as long as all else, 6.8 by the fit's Jacobian, and 0.92 with the model's two deviations in it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfftn, next_fast_len, rfftn
from scipy.ndimage import map_coordinates
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial import cKDTree
from scipy.special import erf

from needlefit.arrays import Floats
from needlefit.imaging.constants import HU, MM, PART, SCANNER, SD
from needlefit.imaging.needle.axis_spline import AxisSpline, axis_frames, axis_sd
from needlefit.imaging.needle.rod_projection import CELL_MM, WATER_PER_MM
from needlefit.imaging.point_spread import (
    HIGHEST,
    LOWEST,
    MAX_FITTED_VOXELS,
    PointSpread,
    expected_spread,
    read_spread,
    robust_sd,
)
from needlefit.imaging.volume import Volume, find_cuts, list_voxels_near, to_patient
from needlefit.schemas.reconstruction import ScannedNeedleRecord

Singles = NDArray[np.float32]

GRID_STEP_MM = CELL_MM  # spacing of the points on which the rod is modelled, mm
FIBRES = 6  # number of fibres along the needle into which a grid's step is divided, in each direction across


class RodModel:
    """Images of a rod of `radius`, from `back` behind to `ahead` of its tip and out to `aside`, mm.

    `normal` (3,) is the slices' normal along s, u and v.
    """

    def __init__(self, radius: float, back: float, ahead: float, aside: float, normal: Floats) -> None:
        self.radius, self.whole = radius, MM.BEYOND_END - back  # where it is not yet cut by the bevel
        # attenuation of a mean chord per HU of the metal, as far as slices cut the rod across
        self.stopped = normal[0] ** 2 * np.pi / 2 * radius * WATER_PER_MM / 1000
        # points along s, and along u and v: the transform repeats, and the blur must not reach round
        count = next_fast_len(int((back + ahead + 2 * MM.BLUR_REACH) / GRID_STEP_MM) + 1, real=True)
        half = next_fast_len(int(2 * (aside + MM.BLUR_REACH) / GRID_STEP_MM) + 1, real=True)
        self.along: Floats = -back - MM.BLUR_REACH + np.arange(count, dtype=np.float64) * GRID_STEP_MM
        self.across: Floats = (np.arange(half, dtype=np.float64) - half // 2) * GRID_STEP_MM
        self.shape = count, half, half
        # angular frequencies across the slices, squared ones in them, 1/mm, and the filter of cubic splines
        turns = [2 * np.pi * np.fft.fftfreq(n, GRID_STEP_MM) for n in (count, half)]
        turns.append(2 * np.pi * np.fft.rfftfreq(half, GRID_STEP_MM))
        k = np.meshgrid(*turns, indexing="ij", sparse=True)
        k_normal = sum(a * n for a, n in zip(k, normal, strict=True))
        filters = [3 / (2 + np.cos(a * GRID_STEP_MM)) for a in k]
        parts = k_normal, sum(a**2 for a in k) - k_normal**2, filters[0] * filters[1] * filters[2]
        self.normal, self.in_slice, self.spline = (np.asarray(part, np.float32) for part in parts)
        # points across with metal (2, C), fibres around each (2, C, F), and the metal's part of these
        fine = ((np.arange(FIBRES) + 0.5) / FIBRES - 0.5) * GRID_STEP_MM
        part = np.stack(np.meshgrid(fine, fine, indexing="ij")).reshape(2, -1)
        self.rows, self.columns = np.nonzero(
            np.hypot(self.across[:, None], self.across) < radius + GRID_STEP_MM
        )
        self.fibres = self.across[np.stack([self.rows, self.columns])][..., None] + part[:, None]
        self.weights = np.clip((radius - np.hypot(*self.fibres)) / (GRID_STEP_MM / FIBRES) + 0.5, 0, 1)
        # of a step's derivatives most are of one rod
        self.transform = lru_cache(maxsize=4)(self._transform)
        self.blur = lru_cache(maxsize=8)(self._blur)

    def _transform(self, roll: float, cotangent: float) -> NDArray[np.complex64]:
        """Return the Fourier transform of the rod, its bevel's point at the angle `roll` from u."""
        cut = (self.radius - np.array([np.cos(roll), np.sin(roll)]) @ self.fibres.swapaxes(0, 1)) * cotangent
        ends = np.clip((-cut - self.along[:, None, None]) / GRID_STEP_MM + 0.5, 0, 1)
        solid = np.zeros(self.shape, dtype=np.float32)
        solid[:, self.rows, self.columns] = np.mean(ends * self.weights, axis=2)
        solid[self.along < self.along[0] + MM.BLUR_REACH / 2] = 0
        return rfftn(solid)

    def _blur(self, roll: float, cotangent: float, spread: PointSpread) -> Singles:
        """Return spline coefficients of the blurred rod of height 1."""
        passed = spread.pass_in_slices(self.in_slice) * spread.pass_across(self.normal) * self.spline
        return irfftn(self.transform(roll, cotangent) * passed, self.shape)

    def image(
        self, roll: float, cotangent: float, spread: PointSpread, places: Floats, height: float
    ) -> Floats:
        """Return the image (N,), HU, of a rod of `height`, HU, at places s, u, v (3, N) from its tip."""
        first = np.array([self.along[0], self.across[0], self.across[0]])
        splines, at = self.blur(roll, cotangent, spread), (places - first[:, None]) / GRID_STEP_MM
        image = np.asarray(map_coordinates(splines, at, order=3, mode="nearest", prefilter=False), float)
        areas, stopped = splines.sum(axis=(1, 2)), max(height * self.stopped, 1e-6)
        filled = np.interp(places[0], self.along, areas / np.interp(self.whole, self.along, areas))
        filled = np.clip(filled, 1e-4, 1.0)
        return height * image * -np.log1p(filled * np.expm1(-stopped)) / (stopped * filled)


# What the 11 parameters are: end along the axis, roll of the bevel, swing across, mm, rad; logarithm of the
# metal's height, and the background, HU; cotangent of the bevel; logarithms of the blurs in and across
# slices, mm, and between them the kernel's boost; the streak beyond the end, HU.
TIP, ROLL, U, V, HEIGHT, LEVEL, COT, BLUR, _, SLICE, STREAK = range(11)
SPREAD = slice(7, 10)
START_ENDS_MM = (-0.5, 0.0, 0.5)  # distances (mm) from a guess of the end at which the bevel's side is tried
STEPS = 30  # largest number of steps of a fit
# step of the difference quotients, over the typical changes: single precision hides smaller ones
DERIVATIVE_STEP = 0.05
MAX_BEVEL_DEG = 85.0  # largest angle (degrees) of a bevel that has a side
ROLL_FACTOR = 3.0  # factor on the roll's deviation: artefacts near the tip
ROLL_SD = 0.15  # SD of the roll (rad) that no residual shows
PARAMETER_SCALES = np.array([0.2, 0.3, 0.1, 0.1, 0.1, 50, 0.3, 0.1, 0.3, 0.2, 100])  # typical changes
# largest difference of the bevel's angle from the stated one, in its deviations, beyond which the image
# contradicts it: right ones at most 1.0, bevels of 20 and 60 degrees for 30 have 3.0
MAX_BEVEL_PULL_SD = 2.5
MIN_BEVEL_PROBABILITY = 0.95  # smallest probability with which the side of the bevel is stated


def point_bevel(u: Floats, v: Floats, roll: float, roll_sd: float) -> Floats:
    """Return the direction (3,) of the bevel's point, rolled from `u` to `v`; nan if its side is unsure."""
    sided = erf(np.pi / 2 / np.sqrt(2) / roll_sd) >= MIN_BEVEL_PROBABILITY  # within 90 degrees
    return np.cos(roll) * u + np.sin(roll) * v if sided else np.full(3, np.nan)


def bevel_length(needle: ScannedNeedleRecord) -> float:
    """Return the length of the bevel: how far behind the point the tip is cut, mm."""
    return needle.diameter_mm / float(np.tan(np.deg2rad(needle.bevel_deg)))


class TipProblem:
    """The voxels around a tip, the model and what is known before."""

    def __init__(
        self,
        volume: Volume,
        axis: AxisSpline,
        needle: ScannedNeedleRecord,
        guess: float,
        spread: PointSpread | None,
    ) -> None:
        heel, radius = bevel_length(needle), needle.diameter_mm / 2
        places, values = list_axis_voxels(volume, axis, guess - heel - MM.EDGE_BLUR, guess + MM.BEYOND_END)
        every = int(np.ceil(len(values) / MAX_FITTED_VOXELS))
        self.places, self.values = places[:, ::every], values[::every]
        self.volume, self.rolled = volume, needle.bevel_deg < MAX_BEVEL_DEG
        frame, normal = axis_frames(axis, np.array([guess])), volume.grid.normal
        # the tip may be found 4 mm from where it is looked for
        back, ahead = heel + MM.EDGE_BLUR + MM.BEYOND_END, 2 * MM.BEYOND_END
        slices = np.stack([frame.tangents[0], frame.u[0], frame.v[0]]) @ normal
        self.rod = RodModel(radius, back, ahead, MM.PATCH + 0.5, slices)
        self.floor, top = find_cuts(values)
        self.ceiling = top if np.isfinite(top) else volume.resampled_top or np.inf
        self.level = float(np.median(values[np.hypot(*places[1:]) > MM.RIM]))
        self.swing = np.clip((self.places[0] - axis.length) / max(guess - axis.length, 0.25), 0, None)
        swing_sd = float(np.hypot(MM.SWING_SD, axis_sd(axis, np.array([axis.length]))[0]))
        cot = heel / needle.diameter_mm
        cot_sd = np.deg2rad(needle.bevel_sd_deg) * (1 + cot**2)
        expected = spread or expected_spread(volume.grid.slice_distance)
        metal, swings, end_sd = SCANNER.METAL, 2 * [swing_sd], MM.BEYOND_END / SD.DISAGREEMENT
        # what is known of the parameters before, and its deviations
        self.means = np.array([guess, 0, 0, 0, np.log(metal.value), self.level, cot, *expected.parameters, 0])
        self.sds = np.array([end_sd, np.inf, *swings, metal.sd, np.inf, cot_sd, *expected.sds, HU.METAL])
        away = np.hypot(*self.places[1:])
        beyond, noise = values[places[0] > guess + 0.5 * MM.BEYOND_END], 50.0
        if beyond.size >= 20:
            noise = max(10.0, robust_sd(beyond - np.median(beyond)))
        error = PART.SIGNAL_ERROR * np.clip(self.values - self.level, 0, None)
        self.sigma = np.sqrt(1 + (away / (2 * SCANNER.BLUR.value)) ** 4) * np.hypot(noise, error)

    def place(self, theta: Floats) -> Floats:
        """Return where the voxels lie from the tip (3, N): along the axis, and across it, mm."""
        s, u, v = self.places
        return np.stack([s - theta[TIP], u - theta[U] * self.swing, v - theta[V] * self.swing])

    def show(self, theta: Floats) -> Floats:
        """Return what the scanner shows in the voxels (N,), HU."""
        places, spread = self.place(theta), read_spread(theta[SPREAD])
        s, u, v = places
        streak = np.exp(-np.maximum(s, 0) / MM.BLUR_REACH - (u**2 + v**2) / (2 * MM.STREAK_RADIUS**2))
        height = float(np.exp(theta[HEIGHT]))
        image = self.rod.image(float(theta[ROLL]), float(theta[COT]), spread, places, height)
        shown = theta[LEVEL] + image + theta[STREAK] * streak
        return np.clip(shown, self.floor, self.ceiling)

    def residuals(self, theta: Floats) -> Floats:
        """Return voxels and what is known, both in their deviations."""
        left = (self.show(theta) - self.values) / self.sigma
        return np.append(left, (theta - self.means) / self.sds)

    def slopes(self, theta: Floats) -> Floats:
        """Return the derivatives of the residuals."""
        here, steps = self.residuals(theta), DERIVATIVE_STEP * PARAMETER_SCALES
        moved = zip(np.diag(steps), steps, strict=True)
        return np.stack([(self.residuals(theta + step) - here) / size for step, size in moved], axis=1)

    def search(self) -> Floats:
        """Return the least squares from the best of several ends and sides of the bevel on."""

        def misfit(start: Floats) -> float:
            return float(np.sum(np.minimum(np.abs(self.residuals(start)), 20)))

        unit, rolls = np.eye(11), np.arange(6 if self.rolled else 1) * np.pi / 3
        starts = [
            self.means + shift * unit[TIP] + roll * unit[ROLL] for roll in rolls for shift in START_ENDS_MM
        ]
        return np.asarray(self.minimize(min(starts, key=misfit)).x, float)

    def fit(self, start: Floats) -> OptimizeResult:
        """Return the least squares near `start` (11,), with the deviations that it leaves.

        Voxels in one blur count as one.
        """
        left = robust_sd(self.residuals(start)[: len(self.values)])
        blurs = 8 * float(np.exp(2 * start[BLUR] + start[SLICE])) / float(np.prod(self.volume.spacing))
        self.sigma = self.sigma * max(1.0, left) * np.sqrt(max(1.0, blurs))
        return self.minimize(start)

    def minimize(self, start: Floats) -> OptimizeResult:
        """Return the least squares from `start` (11,) on."""
        # beyond what is known before artefacts would be taken for the needle's image
        low, high = (self.means + side * SD.DISAGREEMENT * self.sds for side in (-1, 1))
        low[COT] = max(low[COT], 0.0)
        low[SPREAD], high[SPREAD] = np.maximum(low[SPREAD], LOWEST), np.minimum(high[SPREAD], HIGHEST)
        return least_squares(
            self.residuals,
            np.clip(start, low + 1e-6, high - 1e-6),
            jac=self.slopes,
            bounds=(low, high),
            loss="soft_l1",
            f_scale=SD.DISAGREEMENT,
            x_scale=PARAMETER_SCALES,
            ftol=PART.TOLERANCE,
            xtol=PART.TOLERANCE,
            gtol=PART.TOLERANCE,
            max_nfev=STEPS,
        )

    def misfit(self, theta: Floats) -> float:
        """Return how far the image around the end is from the model, in parts of its brightness."""
        inner = np.hypot(*self.place(theta)[1:]) < 2 * self.rod.radius
        shown = self.show(theta)[inner]
        return float(np.linalg.norm(shown - self.values[inner]) / np.linalg.norm(shown - theta[LEVEL]))


def list_axis_voxels(volume: Volume, axis: AxisSpline, start: float, stop: float) -> tuple[Floats, Floats]:
    """Return the voxels within `MM.PATCH` of the axis between `start` and `stop` (mm along it).

    Their places (3, N), along and across, u and v, mm, and their values (N,), HU.
    """
    fine = np.arange(start - 1, stop + 1, 0.1)
    where = axis_frames(axis, fine)
    ijk, values = list_voxels_near(volume, where.origins, MM.PATCH)
    points = to_patient(volume, ijk)
    distance, nearest = cKDTree(where.origins).query(points, distance_upper_bound=MM.PATCH + 0.1)
    close = np.isfinite(distance)
    at = np.asarray(nearest)[close]
    ways = np.stack([where.tangents[at], where.u[at], where.v[at]])
    places = np.einsum("dni,ni->dn", ways, points[close] - where.origins[at])
    near = np.abs(places[0]) < 0.2
    places[0] += fine[at]
    near &= (places[0] >= start) & (places[0] <= stop)
    return places[:, near], values[close][near]


@dataclass(frozen=True)
class TipFit:
    """The fitted tip."""

    at: float  # along the spine, mm
    point: Floats  # (3,); in the patient, mm; beside the spine, if the rod swung
    sd: Floats  # (2,); deviations along the needle, and across it in either direction, mm
    # (3,); unit vector across the needle to the side of the bevel's point; nan for a blunt end, or if the
    # probability of that side is below `MIN_BEVEL_PROBABILITY`.
    bevel: Floats
    roll_sd: float  # deviation of the bevel's roll, rad; nan for a blunt end
    misfit: float = 0.0  # how far the image is from the model, in parts of its brightness
    bevel_deg: float = np.nan  # angle of the bevel as the image shows it, where it contradicts the stated one


def fit_tip(
    volume: Volume, axis: AxisSpline, needle: ScannedNeedleRecord, start: Floats, spread: PointSpread | None
) -> TipFit:
    """Fit the tip near `start` (11,) of `TipProblem.search` by least squares over the voxels around it.

    The tip is where the axis ends that reaches as far as the bevel's point does. The rod is moved along the
    axis, rolled about it, and swung across it from the last cross-section on; the bevel's angle is the
    recipe's within its deviation, unless the image contradicts it.

    `spread` is the scanner's, as balls in the same volume show it.
    """
    problem = TipProblem(volume, axis, needle, float(start[TIP]), spread)
    best, bevel_deg = problem.fit(start), np.nan
    if abs(best.x[COT] - problem.means[COT]) > MAX_BEVEL_PULL_SD * problem.sds[COT]:
        # what is stated of the bevel may be wrong: the image alone shows it, if it is then clearly nearer
        problem.sds[COT] = np.inf
        free = problem.minimize(best.x)
        if problem.misfit(free.x) < PART.BEVEL_MISFIT * problem.misfit(best.x):
            best, bevel_deg = free, float(np.degrees(np.arctan2(1.0, free.x[COT])))
    normal = best.jac.T @ best.jac
    variance = np.diag(np.linalg.inv(normal + 1e-9 * np.diag(np.maximum(np.diag(normal), 1e-9))))
    at, roll = float(best.x[TIP]), best.x[ROLL]
    there = axis_frames(axis, np.array([at]))
    spacing = float(np.linalg.norm(volume.direction.T @ there.tangents[0] * volume.spacing))
    heel = float(axis_sd(axis, np.array([axis.length]))[0])  # from where the rod swings
    across = np.linalg.norm([np.sqrt(variance[[U, V]].mean()), heel, MM.MODEL_SD])
    along = np.linalg.norm([np.sqrt(variance[TIP]), MM.MODEL_SD, PART.TIP_SD * spacing])
    roll_sd = float(np.hypot(ROLL_FACTOR * np.sqrt(variance[ROLL]), ROLL_SD))
    roll_sd = roll_sd if problem.rolled else np.nan
    return TipFit(
        at=at,
        point=there.origins[0] + best.x[U] * there.u[0] + best.x[V] * there.v[0],
        sd=np.array([along, across]),
        bevel=point_bevel(there.u[0], there.v[0], float(roll), roll_sd),
        roll_sd=roll_sd,
        misfit=problem.misfit(best.x),
        bevel_deg=bevel_deg,
    )
