"""Fit a needle that runs in or near the slices to their voxels, as a whole, through its projections.

Rays that run along such a needle pass centimetres of metal in a part of a slice's thickness. The detector
averages intensities, not attenuations, and sees scatter where no ray gets through: the slice is too dark
there, along the whole needle and beyond its end, by as much as the needle is bright. Its axis, what the beam
loses in it, the slices' sensitivity profile and the kernel are fitted together, by projecting a rod, and the
hub that holds it, and reconstructing the slices; what exceeds the scanner's numbers is cut in the model too.

Needles of which rays in a slice pass less are not fitted so. Two oblique ones were: their axes were off by
0.016 mm (by centres of cross-sections 0.013), their tips 0.27 and 0.18 mm too far (by `tip` 0.12 too short
and 0.08 too far), in 17 s of processor each (1.3). Five needles within 10 degrees of slices of 0.4 and 0.45
mm have axes off by 0.019 mm in the median (by cross-sections 0.034 of three, two were refused).

Where a needle lies flat, least squares have several minima: its axis bends from one slice to the next, or
beside the rays that cross it, or lies on the other side of a slice's middle, or where another profile of the
slices shows the same. Hence the axis is moved as a whole and in part, with a coarse rod and with a fine one,
and the scan's parameters are fitted where that leads. Fits begin again at moves along the normal, and of the
end, until none ends lower; of an axis that crosses no slice also at mirror images and at lines added to it.
Of the 38 volumes that are read of 40 (`--seeds 3200:3216`, `3400:3424`) axes are off by 0.05 mm in the mean,
one by 0.31 in the mean of its points. With a profile of five free parameters one was off by 0.75 mm; without
moves of its end a tip was 2 mm short; where the search moves one end of the axis alone, too, two axes were
off by 0.15 mm; without mirror images and lines straight needles of other volumes were off by up to 1 mm.

Metal elsewhere in the slices is not modelled: without it tips of two volumes err by 0.04 and 0.08 mm (with it
by 0.11 and 0.12).
"""

from copy import copy
from dataclasses import replace
from itertools import cycle
from operator import attrgetter
from typing import NamedTuple, Self

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import map_coordinates, minimum_filter
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from needlefit.arrays import Bools, Floats
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import to_unit
from needlefit.geometry.smoothing_spline import DEGREE, make_knots
from needlefit.imaging.constants import MM, PART, SCANNER, SD
from needlefit.imaging.needle.axis_spline import AxisSpline, axis_sd, correlation_factor, fit_axis
from needlefit.imaging.needle.follow import STEP_MM
from needlefit.imaging.needle.hub import Hub, find_hub
from needlefit.imaging.needle.rod_projection import CELL_MM, COLUMN_MM, VIEW_GROWTH, VIEW_STEP, Rod
from needlefit.imaging.needle.tip import MAX_BEVEL_DEG, ROLL_FACTOR, START_ENDS_MM, TipFit, point_bevel
from needlefit.imaging.point_spread import PointSpread, expected_spread, robust_sd
from needlefit.imaging.volume import Volume, to_index
from needlefit.schemas.reconstruction import ReconstructionRecord, ScannedNeedleRecord

LINE_STEP_MM = 0.4  # distance (mm) between samples across the needle
REACH_SLICES = 1.5  # distance, in slices beyond the radius, out to which slices are compared
KNOT_FACTOR = 1.6  # distance of the knots over that of the axis
# A needle between supports is a beam: the third derivative of its axis is the shear force over its stiffness.
SHEAR_SD_MM2 = 4e-5  # SD of the shear force over Young's modulus (mm2): 8 N in steel
# Parameters of the beam, as logarithms. The point spread's follow, and the logarithm of the variance of a
# Gaussian over that of a box, which together make a slice's profile.
BEAM = (SCANNER.ATTENUATION, SCANNER.HARDENING, SCANNER.SCATTER, SCANNER.LINEARITY)
PROFILE_SDS = (0.2, 0.6)  # prior SDs of the slice's blur and of that ratio, as logarithms
TIP_SDS = np.array([1.0, 10.0])  # prior SDs of where the needle ends (mm), and of its bevel's roll (rad)
# sizes of moves: of the axis along the normal in slices, across in mm, of its end in mm
MOVE_SIZES = (0.4, 0.15)
TRIED_MOVES = 6  # number of moves from which a fit begins
TRIED_MIRRORED = 3  # number of mirrored axes from which a fit begins
LINE_SHIFTS = np.arange(-0.6, 0.7, 0.15)  # shifts (slices) of an axis' ends along the normal
MOVED_STEPS = 4  # largest number of steps of such a fit
LEAST_GAIN = 0.5  # smallest fall of the misfit (in squared deviations) that makes a minimum a lower one
# numbers of deviations beyond which residuals count less, in the first fit and later
FIRST_ROBUST_SD = 20.0
ROBUST_SD = 4.0
STEP = 0.05  # step of the difference quotients
VIEW_PART = 0.2  # angle between views along the needle over that at which a ray leaves it within a slice
STEPS = 8  # largest number of steps of a fit
ROUGH_FACTOR = 2.0  # factor on the rod's pieces and on the angles of views while its path is searched
# the model's error in a fit: in water, and as a fraction of the image
MODEL_ERRORS = (0.15, 0.25)
CORRELATED_SAMPLES = 10.0  # number of samples that count as one
# SDs of the axis (slices) that no residual shows: where it does not cross a slice, and per relative misfit of
# the image; at the needle's end the latter is larger by a factor. Of the 38 volumes above errors of tips over
# SDs are 0.7 along the needle, 0.7 and 0.8 across, in root mean square.
MIRROR_SD = 0.15
MISFIT_SD = 0.07
END_FACTOR = 4.0
# SD (mm) of axis and end per relative misfit beyond the one that is spoken of: kernels for edges beside a hub
UNLIKE_SD_MM = 0.5
HUB_SDS = np.array([0.1, 0.3])  # SDs of a needle from its hub's middle: mm, and slices


def place_in_slices(
    volume: Volume, axis: AxisSpline, recipe: ReconstructionRecord, tip: float, spread: PointSpread | None
) -> tuple[AxisSpline, TipFit] | None:
    """Return axis and tip as thick slices show them as a whole.

    `tip`: about where it is, mm along `axis`.

    None where no ray in a slice passes much of the needle, too little of it shows, or it stops few rays and
    the slices are not explained: its sections then are as bright as it is.
    """
    needle = recipe.needle
    thick, normal = volume.grid.slice_distance, volume.grid.normal
    first, last = axis.spline(np.array([0.0, axis.length]))
    steepness = abs(float((last - first) @ normal)) / float(np.linalg.norm(last - first))
    if steepness * MM.DARK >= needle.diameter_mm + thick:  # no rays of a slice pass so much of it
        return None
    points = axis.spline(np.append(np.arange(0.0, tip, STEP_MM), tip))
    hub = find_hub(volume, points, needle.diameter_mm)
    if hub is not None:  # what lies in it is not seen
        points = points[(points - hub.ends[1]) @ (last - first) > 0]
    chord = points[-1] - points[0]
    way = to_unit(chord - chord @ normal * normal)
    frame = np.stack([way, np.cross(normal, way), normal])
    # the middle of the whole needle: projections reach as far on both sides
    origin = points[-1] - way * needle.length_mm / 2
    origin = origin + normal * ((volume.origin - origin) @ normal)  # heights count from the first slice
    x, y, z = ((points - origin) @ frame.T).T
    hub = hub and replace(hub, ends=(hub.ends - origin) @ frame.T)
    problem = _SliceProblem(volume, needle, frame, origin, (x, y, z), spread, hub)
    if np.count_nonzero(problem.seen.any(axis=0)) < 2 * len(problem.start):
        return None
    rough, fine = problem.place_rod(ROUGH_FACTOR), problem.place_rod(1.0)
    start = fine.search(rough.search(np.concatenate([*problem.start.T, [0.0, 0.0], problem.means])))
    theta, covariance, error = fine.solve(start)
    across, along, (end, roll), scan = problem.split(theta)
    transparent = scan[0] < problem.means[0] - SD.DISAGREEMENT * problem.sds[0]
    if transparent and hub is None and error > PART.END_MISFIT:
        return None
    rolled = needle.bevel_deg < MAX_BEVEL_DEG
    count, end = len(across), float(x[-1] + end)
    variances = np.stack([covariance[:count, :count], covariance[count : 2 * count, count : 2 * count]])
    end_sd, roll_sd = np.sqrt(np.diag(covariance)[2 * count : 2 * count + 2])
    # the mirror image of an axis about a slice that it does not cross looks the same
    flat = max(0.0, 1 - float(np.ptp(problem.at @ along)) / thick)
    mirrored, unexplained = thick * MIRROR_SD * flat, thick * MISFIT_SD * error
    unlike = UNLIKE_SD_MM * max(0.0, error - PART.SLICE_MISFIT)
    places = np.append(np.arange(x[0], end - MM.STATION, MM.STATION), end)
    basis = _extend(problem.basis, places)
    beside = np.stack([across, along], axis=1)
    points = origin + np.column_stack([places, basis @ beside]) @ frame
    s = arc_length(points)
    # the tip's stands for that of the last section
    sds = np.delete(np.sqrt(np.einsum("nc,kcd,nd->kn", basis, variances, basis)), -2, axis=1)
    sds = np.hypot(sds, np.linalg.norm([PART.SLICE_SD * thick, mirrored, unexplained, unlike]))
    placed = fit_axis(s[:-1], points[:-1], np.ones(len(s) - 1), MM.KNOT, s[-1])
    # its points are the fit's and do not scatter: its deviation in the slices is the fit's, too
    wider = np.mean(sds[0] ** 2) / np.mean(axis_sd(placed, s[:-1]) ** 2)
    placed = replace(placed, variance=placed.variance * wider, slice_sds=sds)
    along_sd = np.linalg.norm([end_sd, END_FACTOR * unexplained, unlike])
    end_sds = np.array([along_sd, np.linalg.norm(sds[:, -1]) / np.sqrt(2)])
    roll_sd = ROLL_FACTOR * float(roll_sd) if rolled else np.nan
    bevel = point_bevel(frame[1], normal, float(roll), roll_sd)
    return placed, TipFit(float(s[-1]), points[-1], np.hypot(end_sds, MM.MODEL_SD), bevel, roll_sd, error)


def _extend(spline: BSpline, x: Floats) -> Floats:
    """Return a spline at `x` (N,), straight beyond its ends."""
    inside = np.clip(x, spline.t[0], spline.t[-1])
    return spline(inside) + spline.derivative()(inside) * (x - inside)[:, None]


class _Minimum(NamedTuple):
    """Parameters `theta` (P,) that fit slices best near a start."""

    misfit: float
    theta: Floats
    jacobian: Floats  # (R, P); of the residuals


class _SliceProblem:
    """What slices (K,) show on lines (U,) across the needle at stations (S,), and what a rod would show.

    Parameters: coefficients of the axis across and along the normal, end, the bevel's roll, and the scan's.
    """

    to_columns: Floats  # (columns, C) from coefficients to the axis at the pieces of the rod
    end: float  # about where the needle ends, mm
    rod: Rod
    projected: tuple[Floats, csr_array]  # parameters of the needle that was projected last, its metal
    held: csr_array  # the hub on the rays

    def __init__(
        self,
        volume: Volume,
        needle: ScannedNeedleRecord,
        frame: Floats,
        origin: Floats,
        axis: tuple[Floats, Floats, Floats],
        spread: PointSpread | None,
        hub: Hub | None,
    ) -> None:
        """Sample slices around `axis` (x, y, z) and `hub`, both in `frame` (3, 3) from `origin`, mm."""
        x, y, z = axis
        thick, radius = volume.grid.slice_distance, needle.diameter_mm / 2
        knots = make_knots(x[0], x[-1], KNOT_FACTOR * MM.KNOT)
        self.basis = basis = BSpline(knots, np.eye(len(knots) - DEGREE - 1), DEGREE)
        stations = np.arange(x[0], x[-1] + MM.BEYOND_END, STEP_MM)
        self.at = _extend(basis, stations)  # (S, C) from coefficients to the axis at stations
        # where the axis follows a staircase from slice to slice, or rays that pull it aside, polynomials do
        # not
        places = np.column_stack([x, y, z])
        if hub is not None:  # its shadow pulls the axis aside where it begins
            places = np.vstack([places[x > x[0] + MM.HIDDEN], hub.ends[1:]])
        fit = np.polynomial.Polynomial.fit
        course = [fit(places[:, 0], places[:, n], degree)(x) for n, degree in ((1, 3), (2, 2))]
        start = np.linalg.lstsq(_extend(basis, x), np.stack(course, axis=1))[0]
        self.start: Floats = np.asarray(start, float)  # (C, 2)
        self.first_of_scan = start.size + 2
        self.projected = np.empty(0), csr_array((0, 0))
        line = np.arange(-MM.PATCH, MM.PATCH + 1e-6, LINE_STEP_MM)
        height = self.at @ self.start[:, 1] / thick
        last = volume.values.shape[0] - 1
        slices = np.arange(max(0, int(height.min()) - 1), min(last, int(height.max()) + 2) + 1)
        side = (self.at @ self.start[:, 0])[:, None] + line
        flat = (origin + stations[:, None, None] * frame[0] + side[..., None] * frame[1]).reshape(-1, 3)
        there = [to_index(volume, flat + k * thick * volume.grid.normal)[:, 1::-1].T for k in slices]
        planes = [volume.values[k].astype(float) / 1000 for k in slices]  # water 1
        pairs = zip(planes, there, strict=True)
        shown = np.stack([map_coordinates(plane, index, order=1, cval=np.nan) for plane, index in pairs])
        shown = shown.reshape(len(slices), *side.shape)
        self.seen: Bools = np.isfinite(shown).all(axis=-1)  # (K, S)
        self.seen &= np.abs(slices[:, None] - height) < REACH_SLICES + radius / thick
        low, top = np.nanmin(shown), np.nanmax(shown) - 5e-4
        # smallest and largest that the scanner shows
        self.cut = low, top if np.count_nonzero(shown > top) > 3 else np.inf
        self.shown: Floats = np.where(self.seen[..., None], shown, 0.0)  # (K, S, U)
        self.line, self.rim = line, np.abs(line) > MM.RIM  # (U,); the second shows the surroundings
        self.level = self.shown[..., self.rim].mean(axis=-1, keepdims=True)  # (K, S, 1); their brightness
        # deviations of what slices show in a fit (K, S, U)
        self.scale = np.hypot(MODEL_ERRORS[0], MODEL_ERRORS[1] * (self.shown - self.level))
        unique, moment = np.unique(knots), np.pi * needle.diameter_mm**4 / 64
        shear = basis.derivative(3)((unique[1:] + unique[:-1]) / 2)
        bent = np.vstack([shear, basis.derivative(2)(unique[-1:]) / MM.END_MOMENT])
        self.bent = bent * moment / SHEAR_SD_MM2  # (J, C) from coefficients to shear forces, in deviations
        self.hub, self.thick, self.needle = hub, thick, needle
        slope = abs(z[-1] - z[0]) / (x[-1] - x[0])
        self.view_step = max(VIEW_STEP, VIEW_PART * needle.diameter_mm * slope / (needle.diameter_mm + thick))
        self.last, self.samples = x[-1], (thick, slices * thick, stations, side)
        expected = spread or expected_spread(thick)
        known = [*expected.parameters, np.log(1 / PART.BOX - 1)]
        # what is known of the parameters of the scan (8,), and its deviations
        self.means = np.concatenate([np.log([part.value for part in BEAM]), known])
        self.sds = np.concatenate([[part.sd for part in BEAM], expected.sds[:2], PROFILE_SDS])

    def place_rod(self, rough: float) -> Self:
        """Return the problem of a rod in these samples; pieces, and angles of the views, grow by `rough`."""
        placed, radius, step = copy(self), self.needle.diameter_mm / 2, rough * CELL_MM
        # short pieces at the end: with long ones 12 tips were 0.11 mm short in the mean, with these 0.08
        begin, end = self.last + np.array([-1, 1]) * MM.BEYOND_END
        shaft = np.arange(begin, self.last - self.needle.length_mm, -rough * COLUMN_MM)
        columns = np.append(np.arange(end, begin, -step), shaft)
        placed.to_columns = _extend(self.basis, columns)
        # a blunt end is a bevel of one piece of the rod, too, whose middle is where it ends
        true = np.tan(np.radians(self.needle.bevel_deg))
        steep = min(true, 2 * radius / step)
        # a bevel that projects as the end does reaches farther
        placed.end = self.last + radius / steep - radius / true
        placed.rod = Rod(columns, radius, steep, *self.samples, rough * self.view_step, rough * VIEW_GROWTH)
        if self.hub is not None:
            places, *course = self.hub.ends.T
            begin, end = places.tolist()
            across, along = (np.interp(columns, places, beside) for beside in course)
            placed.held = placed.rod.lengths(across, along, end, 0.0, (begin, self.hub.radius))
        return placed

    def split(self, theta: Floats) -> list[Floats]:
        """Return the parameters of each kind."""
        count = self.at.shape[1]
        return np.split(theta, [count, 2 * count, 2 * count + 2])

    def prior(self, theta: Floats) -> Floats:
        """Return the deviations from what is known before the fit, over their SDs; linear in `theta`."""
        across, along, end, scan = self.split(theta)
        pulls = [self.bent @ across, self.bent @ along, end / TIP_SDS, (scan - self.means) / self.sds]
        if self.hub is not None:
            place = self.hub.ends[1]
            row = _extend(self.basis, place[:1])
            sds = HUB_SDS * np.array([1.0, self.thick])
            pulls += [(row @ across - place[1]) / sds[0], (row @ along - place[2]) / sds[1]]
        return np.concatenate(pulls)

    def project(self, theta: Floats) -> csr_array:
        """Return the metal on the rays, which is kept while only parameters of the scan change."""
        path = theta[: self.first_of_scan]
        if not np.array_equal(path, self.projected[0]):
            across, along, (end, roll), _ = self.split(theta)
            course = self.to_columns @ across, self.to_columns @ along
            metal = self.rod.lengths(*course, self.end + float(end), float(roll))
            self.projected = path.copy(), metal if self.hub is None else metal + self.held
        return self.projected[1]

    def image(self, theta: Floats, aside: float = 0.0) -> Floats:
        """Return what slices show (K, S, U), `aside` mm beside their samples."""
        over = self.rod.show(self.project(theta), self.split(theta)[-1], aside)
        over = over - over[..., self.rim].mean(axis=-1, keepdims=True)
        return np.clip(over + self.level, *self.cut)

    def weigh(self, image: Floats) -> Floats:
        """Return an image (K, S, U) in its deviations, where slices are seen; neighbours count as one."""
        return (image / self.scale)[self.seen].ravel() / np.sqrt(CORRELATED_SAMPLES)

    def residuals(self, theta: Floats) -> Floats:
        """Return what slices show and what is known, both in their deviations."""
        return np.append(self.weigh(self.image(theta) - self.shown), self.prior(theta))

    def differentiate(self, theta: Floats, first: int = 0) -> Floats:
        """Return the derivatives of the residuals by the parameters from `first` on.

        By the coefficients across the needle they are those of an image that moves with the needle: the true
        ones lead to axes that fit the model's errors.
        """
        here, prior, count = self.residuals(theta), self.prior(theta), self.at.shape[1]
        steps = np.eye(len(theta)) * STEP
        columns = [(self.residuals(theta + step) - here) / STEP for step in steps[max(first, count) :]]
        if first == 0:
            shift = (self.image(theta, STEP) - self.image(theta)) / STEP
            pairs = zip(self.at.T, steps, strict=False)
            columns[:0] = [
                np.append(self.weigh(-shift * column[:, None]), (self.prior(theta + step) - prior) / STEP)
                for column, step in pairs
            ]
        return np.stack(columns, axis=1)

    def loss(self, squared: Floats) -> Floats:
        """Return Cauchy's loss of squared residuals (R,) of the image, and its derivatives (3, R)."""
        shown = np.arange(len(squared)) < np.count_nonzero(self.seen) * self.shown.shape[2]
        less = np.where(shown, 1 / (1 + squared), 1.0)
        return np.stack([np.where(shown, np.log1p(squared), squared), less, np.where(shown, -(less**2), 0.0)])

    def descend(
        self,
        start: Floats,
        steps: int = STEPS,
        jacobian: Floats | None = None,
        first: int = 0,
        robust: float = ROBUST_SD,
    ) -> "_Minimum":
        """Return the least squares near `start`.

        `jacobian`: the derivatives near `start`, if they are known. Parameters before `first` stay.
        """
        last_residuals: list[Floats] = []  # where derivatives are asked for
        last: list[Floats] = []  # where they were asked for last, with residuals and derivatives
        kept = cycle((True, True, False))

        def evaluate(there: Floats) -> Floats:
            last_residuals[:] = [self.residuals(np.append(start[:first], there))]
            return last_residuals[0]

        # derivatives are calculated at every third step, or given; at other steps the last ones are corrected
        # by what that step showed (C. G. Broyden, Math. Comp. 19 (1965) 577-593)
        def find_jacobian(there: Floats) -> Floats:
            if last and (jacobian is not None or next(kept)):
                before, residuals, here = last
                step = there - before
                weight = step * np.sum(here**2, axis=0)
                error = last_residuals[0] - residuals - here @ step
                here = here + np.outer(error, weight / (weight @ step))
            elif jacobian is None:
                here = self.differentiate(np.append(start[:first], there), first)
            else:
                here = jacobian
            last[:] = there, last_residuals[0], here
            return here

        solved = least_squares(
            evaluate,
            start[first:],
            jac=find_jacobian,
            loss=self.loss,  # type: ignore[arg-type]  # the stubs describe another function
            f_scale=robust / np.sqrt(CORRELATED_SAMPLES),
            x_scale="jac",
            ftol=PART.TOLERANCE,
            xtol=PART.TOLERANCE,
            gtol=PART.TOLERANCE,
            max_nfev=steps,
        )
        return _Minimum(2 * float(solved.cost), np.append(start[:first], solved.x), last[2])

    def search(self, best: Floats) -> Floats:
        """Return where moves of axis and end from `best` lead, and the parameters of the scan there."""
        across, normal, end = self.moves
        moves = np.vstack([across[:-2], normal[:-2], end])  # of one end of the axis alone they lead astray
        lowest = self.misfit(best)
        for size in MOVE_SIZES:
            improved = True
            while improved:
                improved = False
                for move in [*moves, *-moves]:
                    if (cost := self.misfit(best + size * move)) < lowest:
                        best, lowest, improved = best + size * move, cost, True
        return self.descend(best, first=self.first_of_scan).theta

    @property
    def moves(self) -> tuple[Floats, Floats, Floats]:
        """Moves (M, P) of the axis by 1 mm across and by 1 slice along the normal, and of its end by 1 mm.

        Of the axis as a whole, in part, and of one end.
        """
        x, count = np.linspace(0, 1, len(self.start)), len(self.start)
        parts = [np.ones_like(x), 2 * x - 1, 4 * x * (1 - x), x**2, (1 - x) ** 2, x**6, (1 - x) ** 6]
        unit = np.eye(self.first_of_scan + len(self.means))
        across, normal = (parts @ unit[first : first + count] for first in (0, count))
        return across, self.thick * normal, unit[2 * count : 2 * count + 1]

    def solve(self, start: Floats) -> tuple[Floats, Floats, float]:
        """Return parameters near `start`, their covariance and the model's relative error."""
        # with ends before rolls a tip was 0.41 mm short, with both at once 0.01
        first = self.descend(self.choose_end(start), robust=FIRST_ROBUST_SD)
        minimum = self.leave_minima(self.descend(self.choose_end(first.theta), jacobian=first.jacobian))
        best = self.descend(self.choose_end(minimum.theta), jacobian=minimum.jacobian).theta
        image = self.image(best)
        self.scale = scale = self.measure_deviations(image)
        jacobian = self.differentiate(best)
        left = np.where(self.seen[..., None], image - self.shown, 0.0) / scale
        left /= np.sqrt(1 + (left / ROBUST_SD) ** 2)
        factor = correlation_factor(np.moveaxis(left, 1, 0).reshape(left.shape[1], -1), len(best))
        covariance = np.linalg.inv(jacobian.T @ jacobian) * factor / CORRELATED_SAMPLES
        return np.asarray(best, float), np.asarray(covariance, float), self.error(image)

    def leave_minima(self, best: "_Minimum") -> "_Minimum":
        """Return a minimum from whose neighbourhood no fit leads to a lower one.

        Fits begin at moves of the axis along the normal, and of its end; of an axis that crosses no slice
        also at its mirror images, and at lines that are added to it. Those that end lowest after one step go
        on.
        """
        moves = np.vstack([size * np.vstack(self.moves[1:]) for size in MOVE_SIZES])
        flat = np.ptp(self.at @ self.split(best.theta)[1]) < self.thick
        lines = self.add_lines(best.theta) if flat else []
        while True:
            steps = [
                self.descend(best.theta + move, steps=2, jacobian=best.jacobian) for move in [*moves, *-moves]
            ]
            far = [*self.mirror(best.theta), *lines] if flat else []
            steps += [self.descend(theta, steps=2) for theta in far]
            lines = []
            for start in sorted(steps, key=attrgetter("misfit"))[:TRIED_MOVES]:
                tried = self.descend(start.theta, steps=MOVED_STEPS, jacobian=start.jacobian)
                if tried.misfit < best.misfit - LEAST_GAIN:
                    best = self.descend(tried.theta)
                    break
            else:
                return best

    def mirror(self, theta: Floats) -> list[Floats]:
        """Return mirror images of the axis, or of one side of it, about slices' middles, the best first."""
        _, along, *_ = self.split(theta)
        height, mirrored = self.at @ along, list[Floats]()
        bent = np.vstack([self.at, self.bent])  # the mirrored axis is smooth, too
        for middle in self.thick * np.unique(np.rint(height / self.thick)):
            nearest = int(np.argmin(np.abs(height - middle)))
            for side in (slice(nearest), slice(nearest, None), slice(None)):
                turned = height.copy()
                turned[side] = 2 * middle - turned[side]
                course = np.linalg.lstsq(bent, np.append(turned, np.zeros(len(self.bent))))[0]
                mirrored.append(theta.copy())
                mirrored[-1][len(along) : 2 * len(along)] = course
        return sorted(mirrored, key=self.misfit)[:TRIED_MIRRORED]

    def add_lines(self, theta: Floats) -> list[Floats]:
        """Return the axis with lines added along the normal that have lower misfits than lines near them."""
        whole, turn = self.moves[1][:2]
        before, behind = (whole - turn) / 2, (whole + turn) / 2
        axes = theta + LINE_SHIFTS[:, None, None] * before + LINE_SHIFTS[:, None] * behind
        misfits = np.apply_along_axis(self.misfit, 2, axes)
        lowest = misfits == minimum_filter(misfits, 3)
        order = np.argsort(misfits[lowest])
        return [*axes[lowest][order][:TRIED_MOVES]]

    def misfit(self, theta: Floats) -> float:
        """Return what is minimized."""
        robust = ROBUST_SD / np.sqrt(CORRELATED_SAMPLES)
        left = self.residuals(theta) / robust
        return float(robust**2 * np.sum(self.loss(left**2)[0]))

    def choose_end(self, theta: Floats) -> Floats:
        """Return the parameters with the best of several ends and rolls of the bevel."""
        end, roll = np.eye(len(theta))[2 * len(self.start) :][:2]
        sides = np.arange(6) * np.pi / 3
        return min(
            (theta + away * end + side * roll for away in START_ENDS_MM for side in sides),
            key=self.misfit,
        )

    def measure_deviations(self, image: Floats) -> Floats:
        """Return the deviations of what slices show (K, S, U) that residuals of `image` show."""
        seen, over = self.seen[..., None], np.abs(image - self.level)
        bright = seen & (over > PART.FAINT * np.percentile(over[self.seen], 97))
        left = np.abs(image - self.shown)
        noise = robust_sd(left[seen & ~bright])
        error = robust_sd(left[bright] / over[bright])
        return np.hypot(max(noise, 0.005), np.clip(error, 0.02, 0.5) * over)

    def error(self, image: Floats) -> float:
        """Return the relative error of what slices show."""
        left, over = (image - self.shown)[self.seen], (image - self.level)[self.seen]
        return float(np.linalg.norm(left) / np.linalg.norm(over))
