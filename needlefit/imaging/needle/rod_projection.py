"""Project a rod in the planes of slices, and reconstruct these from the projections, as a scanner does."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.sparse import csr_array
from scipy.special import expit

from needlefit.arrays import Floats
from needlefit.imaging.point_spread import PointSpread

COLUMN_MM = 0.75  # length (mm) of the pieces of the rod along it, but at its end
CELL_MM = 0.25  # width (mm) of the cells of the detector, and largest distance of planes
PLANE_STEP = 6  # divisor of the number of planes of a slice
VIEW_STEP = 0.013  # smallest angle (rad) between views
VIEW_GROWTH = 0.13  # growth of that angle, per angle to the needle
WATER_PER_MM = 0.02  # attenuation of water (1/mm)


@dataclass(frozen=True)
class Rod:
    """Projects a rod in the planes of slices, and reconstructs these where they are sampled."""

    columns: Floats  # (C,); pieces of the rod along the needle, mm
    radius: float
    steep: float  # tangent of the bevel's angle to the axis
    thick: float
    heights: Floats  # (K,); of the slices, mm
    stations: Floats  # (S,); where slices are sampled: along the needle
    side: Floats  # (S, U); and across it
    view_step: float  # angle between views along the needle, rad
    view_growth: float  # growth of that angle, per angle to the needle
    _back_projections: dict[float, csr_array] = field(default_factory=dict, compare=False)

    @cached_property
    def views(self) -> tuple[Floats, Floats]:
        """Angles of the rays to the needle (V,) and their weights; dense where rays run along it."""
        half = [0.0]
        while half[-1] < np.pi / 2:
            half.append(half[-1] * (1 + self.view_growth) + self.view_step)
        turned = np.array(half) * (np.pi / 2 / half[-1])
        angles = np.concatenate([-turned[:0:-1], turned])
        weights = np.gradient(angles)
        return angles, weights * np.pi / weights.sum()

    @property
    def planes(self) -> Floats:
        """Heights of the planes (P,), mm."""
        n = self.in_slice
        count = n * (len(self.heights) + 1) - 1
        return self.heights[0] + self.thick / n * (np.arange(count) - n + 1)

    @property
    def in_slice(self) -> int:
        """Number of planes in a slice."""
        return PLANE_STEP * int(np.ceil(self.thick / (PLANE_STEP * CELL_MM)))

    @cached_property
    def half(self) -> int:
        """Cells on either side of the middle."""
        reach = max(np.abs(self.columns).max(), np.abs(self.stations).max(), np.abs(self.side).max())
        return int(np.hypot(reach, np.abs(self.side).max()) / CELL_MM) + 8

    @cached_property
    def _ramp(self) -> tuple[Floats, Floats]:
        """Frequencies, 1/mm, and the ramp, sampled in space: in frequency that would shift the mean."""
        length = next_fast_len(3 * self.half, real=True)  # beyond these cells the ramp is small
        n = np.concatenate([np.arange(length // 2 + 1), np.arange(length // 2 + 1 - length, 0)])
        ramp = np.where(n % 2, -1 / (np.pi * np.where(n == 0, 1, n) * CELL_MM) ** 2, 0.0)
        ramp[0] = 1 / (2 * CELL_MM) ** 2
        return rfftfreq(length, CELL_MM), rfft(ramp).real * CELL_MM

    @staticmethod
    def _half_area(height: Floats, radius: float) -> Floats:
        """Return half the area of a rod's section below `height` from its middle, mm2."""
        u = np.clip(height / radius, -1, 1)
        return radius**2 / 2 * (u * np.sqrt(1 - u**2) + np.arcsin(u))

    def back_projection(self, aside: float) -> csr_array:
        """Return the sum over the views (S U, V cells) at the samples moved by `aside` mm, interpolated."""
        if aside not in self._back_projections:
            angles, _ = self.views
            across = (self.side[..., None] + aside) * np.cos(angles)
            place = (across - self.stations[:, None, None] * np.sin(angles)) / CELL_MM + self.half
            low = np.floor(place).astype(np.int64)
            beyond = (place - low).reshape(-1, len(angles))
            first = (low + 2 * self.half * np.arange(len(angles))).reshape(beyond.shape)
            columns = np.concatenate([first, first + 1], axis=1)
            parts = np.concatenate([1 - beyond, beyond], axis=1).astype(np.float32)
            ends = np.arange(len(columns) + 1) * columns.shape[1]
            shape = (len(columns), 2 * self.half * len(angles))
            self._back_projections[aside] = csr_array((parts.ravel(), columns.ravel(), ends), shape=shape)
        return self._back_projections[aside]

    def lengths(
        self, across: Floats, along: Floats, end: float, roll: float, hub: tuple[float, float] | None = None
    ) -> csr_array:
        """Return the metal of a rod (P, V N) in every plane, on the cells of all views, mm.

        `across`, `along`: (C,); where the axis lies. `end`: where the bevel's point is; `roll`: its side,
        from the direction across. `hub`: of a hub that ends there its beginning, and its radius, mm.
        """
        rise, drift = np.gradient(along, self.columns), np.gradient(across, self.columns)
        steepness = np.sqrt(1 + rise**2)
        away = (self.planes[:, None] - along) / steepness
        # half the mean chord in the thickness of a plane: smooth as the rod moves through the planes
        reach = self.thick / self.in_slice / 2 / steepness
        radius = self.radius if hub is None else hub[1]
        chord = self._half_area(away + reach, radius) - self._half_area(away - reach, radius)
        chord /= 2 * reach
        piece = np.abs(np.gradient(self.columns))
        # of the chord the part beyond the bevel's face is missing; a face along the chord crosses it over the
        # length of a piece
        lean = np.maximum(chord * abs(np.cos(roll)), piece * self.steep / 2)
        face = self.radius - away * np.sin(roll) - (end - self.columns) * self.steep
        part = np.clip((lean - face) / (2 * lean), 0, 1)
        if hub is not None:
            part = np.where((self.columns > hub[0]) & (self.columns < end), np.ones_like(part), 0.0)
        plane, c = np.nonzero((chord > 0) & (part > 0))
        chord, part, slant = chord[plane, c], part[plane, c], np.sqrt(1 + drift[c] ** 2)
        width = 2 * chord * part * slant
        place = across[c] + np.sign(np.cos(roll)) * chord * (1 - part) * slant
        # every piece is a parallelogram, whose image is a trapezoid; in single precision it is twice as fast
        angles, count = self.views[0], 2 * self.half
        sine, cosine = np.sin(angles).astype(np.float32), np.cos(angles).astype(np.float32)
        pieces = np.stack([width, place, drift[c], self.columns[c], piece[c]])[..., None].astype(np.float32)
        width, place, drift, at, piece = pieces
        middle = (place * cosine - at * sine) / CELL_MM + self.half
        long = np.maximum(width * np.abs(cosine) / CELL_MM, 0.5)
        wide = np.maximum(np.abs(drift * cosine - sine) * piece / CELL_MM, 0.5)
        height, outer = width * piece / CELL_MM / (long * wide), (long + wide) / 2
        first = np.ceil(middle - outer)
        covered = np.arange(int(2 * outer.max(initial=0)) + 1)[:, None, None]  # cells, from the first on
        parts = first - middle + covered.astype(np.float32)
        np.subtract(outer, np.abs(parts, out=parts), out=parts)  # in place: half the time is memory's
        np.clip(parts, 0, np.minimum(long, wide), out=parts)
        parts *= height
        met, row = np.unique(plane, return_inverse=True)  # most planes show no metal
        views = (row[:, None] * len(angles) + np.arange(len(angles))) * count
        cells = np.clip(first, 0, count - len(covered)).astype(np.int64) + views + covered
        shape = len(self.planes), len(angles) * count
        stored = np.bincount(cells.ravel(), parts.ravel(), minlength=len(met) * shape[1])
        lit = np.flatnonzero(stored > 0)  # of numbers it takes five times as long
        row, cell = np.divmod(lit, shape[1])
        ends = np.searchsorted(met[row], np.arange(shape[0] + 1))
        return csr_array((stored[lit].astype(np.float32), cell, ends), shape)

    def show(self, metal: csr_array, scan: Floats, aside: float = 0.0) -> Floats:
        """Return the slices (K, S, U), water 1, over their surroundings, where `metal` is on their rays.

        They are shown `aside` mm beside the samples. `scan`: (8,); see `slice_fit`.
        """
        attenuation, variance, scatter, linear, blur = np.exp(scan[:5])
        boost, slice_blur, edge = scan[5:]
        spread = PointSpread(float(blur), float(boost), float(np.exp(slice_blur)), box=float(expit(-edge)))
        away = np.abs(np.arange(1 - self.in_slice, self.in_slice)) / self.in_slice
        profile = spread.weigh_planes(away * self.thick)
        mix = np.zeros((len(self.heights), len(self.planes)), dtype=np.float32)
        for k, row in enumerate(mix):
            row[k * self.in_slice : k * self.in_slice + len(profile)] = profile / profile.sum()
        # an attenuation that is gamma distributed over the spectrum: the beam hardens; `log` and `exp` of
        # single precision are vectorised, `log1p` and `expm1` are not
        passed = np.log(1 + metal.data * np.float32(attenuation * variance / linear))
        in_planes = csr_array(metal)
        in_planes.data = 1 - np.exp(passed * np.float32(-1 / variance))
        in_slices = csr_array(mix) @ in_planes
        rows = np.diff(in_slices.indptr) > 0
        stopped = in_slices[rows].toarray()
        # a cell's aperture; views begin and end without metal
        stopped[:, 1:-1] = stopped[:, 1:-1] / 2 + (stopped[:, 2:] + stopped[:, :-2]) / 4
        logs = -np.log(1 - stopped * np.float32(1 / (1 + scatter)))
        logs = logs.reshape(len(logs), len(self.views[0]), -1)
        frequencies, ramp = self._ramp
        window = (ramp * spread.pass_in_slices((2 * np.pi * frequencies) ** 2)).astype(np.float32)
        length = 2 * (len(frequencies) - 1)
        filtered = irfft(rfft(logs, length) * window, length)[..., : 2 * self.half]
        filtered = filtered * (self.views[1] * linear / WATER_PER_MM).astype(np.float32)[:, None]
        image = np.zeros((len(mix), *self.side.shape))
        shown = self.back_projection(aside) @ filtered.reshape(len(filtered), -1).T
        image[rows] = shown.T.reshape(-1, *self.side.shape)
        return image
