"""Simulate one true insertion in three dimensions: the needle's shape, and the layers that it crosses."""

from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.geometry.crossings import find_crossings
from needlefit.geometry.frames import Frame, make_entry_frame
from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from synthetic import design

MAX_POINT_SPACING_MM = 0.5  # distance between the points of a centreline, mm (at most)
# A finer mesh than is fitted with (the constraint spacing is part of the model).
TRUTH_OPTIONS = ModelOptions(element=0.25)
# Thickness of the slices in which a piece that is not homogeneous is cut along the needle, mm.
SUBLAYER_THICKNESS_MM = 2.0
CONVERGENCE_MM = 1e-5  # mm; needle and layers agree when no point moves by more from one round to the next
MAX_ROUNDS = 60


@dataclass(frozen=True)
class TrueInsertion:
    """One insertion as it really is: shape, centreline and layers."""

    frame: Frame  # C in the world, y toward where the bevel really faces
    shape: NeedleShape  # in C, in the plane of the bevel
    centerline: Floats  # (N, 3); world points from entry to tip, with the bending out of the plane, mm
    boundaries: Floats  # (n - 1,); depths of the interfaces met, along C's x, mm
    sequence: tuple[int, ...]  # layers met
    tissue: Tissue  # what the needle met: these layers, or thin slices of a smooth field

    @property
    def deflection(self) -> float:
        """Deflection of the tip from the entry in the plane of the bevel, mm."""
        ends = compute_positions(self.shape, np.array([0.0, self.shape.depth]))
        return float(ends[1, 1] - ends[0, 1])


def insert_needle(
    planned: design.InsertionDesign,
    needle: Needle,
    specimen: design.TrueSpecimen,
    deviations: design.DesignDeviations,
) -> TrueInsertion:
    """Simulate the needle; the layer depths are those at which its final shape crosses the surfaces.

    Shape and depths are found by iteration: a needle through the layers met by the last one, first along the
    straight axis. ModelError if the two do not come to agree, or the solution exceeds
    a limit of its validity.
    """
    stated = stated_frame(planned)
    x, y, z = stated.rotation.T
    origin = stated.origin + deviations.shift @ np.stack([y, z])
    direction = x + deviations.tilt @ np.stack([y, z])
    frame = make_entry_frame(origin, direction, np.cos(deviations.roll) * y + np.sin(deviations.roll) * z)
    bevel = Bevel(design.bevel_offset(specimen, planned, deviations))
    curve = frame.to_world(np.outer(centerline_stations(planned.depth), [1.0, 0.0, 0.0]))
    for _ in range(MAX_ROUNDS):
        met = find_crossings(curve, specimen.surfaces)
        boundaries, sequence = frame.to_local(met.points)[:, 0], met.sequence
        tissue = _tissue_along(curve, frame, specimen, boundaries, sequence)
        shape = simulate(needle, tissue, bevel, planned.depth, rules=TRUTH_OPTIONS)
        last, curve = curve, needle_points(shape, frame, deviations, centerline_stations(shape.depth))
        if not shape.converged:
            break
        if np.abs(curve - last).max() < CONVERGENCE_MM:
            if not shape.valid:  # no real needle bends as the model does there
                raise ModelError(
                    f"insertion {planned.id} exceeds a limit: {'; '.join(shape.validity.faults)}",
                    fix="take another seed",
                )
            return TrueInsertion(frame, shape, curve, boundaries, sequence, tissue)
    raise ModelError(
        f"insertion {planned.id} does not settle ({shape.status})", fix="plan it farther from a layer's edge"
    )


def stated_frame(planned: design.InsertionDesign) -> Frame:
    """Return the frame C as the stage and the bevel's mark state it."""
    return make_entry_frame(planned.origin, planned.direction, planned.toward)


def centerline_stations(depth: float) -> Floats:
    """Return the arc lengths (N,) of a centreline's points, 0 to `depth`, mm."""
    return np.linspace(0.0, depth, int(np.ceil(depth / MAX_POINT_SPACING_MM)) + 1)


def needle_points(shape: NeedleShape, frame: Frame, deviations: design.DesignDeviations, s: Floats) -> Floats:
    """Return the needle's world points (N, 3) at arc lengths `s` (N,), mm; negative before the tissue.

    In the tissue it is bent out of its plane the more the more it bends within.
    """
    amplitude = 0.04 + 0.06 * abs(shape.tip_lateral)
    along = np.clip(s, 0.0, None) / shape.depth
    # powers 2 and 3 leave position and slope at the entry unchanged
    aside = amplitude * (deviations.out_of_plane @ np.stack([along**2, along**3]))
    points = compute_positions(shape, s)
    points[:, 2] += aside
    return frame.to_world(points)


def _tissue_along(
    curve: Floats, frame: Frame, specimen: design.TrueSpecimen, boundaries: Floats, sequence: tuple[int, ...]
) -> Tissue:
    """Return the tissue along the needle: its layers, or thin slices through a smooth field."""
    # layer numbers begin at 1
    layers = np.array(sequence) - 1
    mu, alpha = specimen.mu[layers], specimen.alpha[layers]
    if specimen.field is not None:
        x = frame.to_local(curve)[:, 0]
        count = int(np.ceil(x[-1] / SUBLAYER_THICKNESS_MM))
        middles = SUBLAYER_THICKNESS_MM * (np.arange(count) + 0.5)
        places = np.column_stack([np.interp(middles, x, axis) for axis in curve.T])
        mu = specimen.mu[0] * np.exp(specimen.field.at(places))
        alpha, boundaries = np.full(count, specimen.alpha[0]), SUBLAYER_THICKNESS_MM * np.arange(1.0, count)
    return Tissue(mu, alpha, boundaries, friction=np.array([specimen.friction]), is_checked=True)


TWIN_SEED = 1  # the seed of the twin that ships


@dataclass(frozen=True)
class SyntheticInsertion:
    """One insertion of the twin: its plan, and what really happened."""

    planned: design.InsertionDesign
    specimen: design.TrueSpecimen
    deviations: design.DesignDeviations
    true_insertion: TrueInsertion


def simulate_insertion(
    planned: design.InsertionDesign, seed: int, population: design.TrueSpread | None = None
) -> SyntheticInsertion:
    """Simulate one insertion; the result depends on its own plan, the seed and the population only."""
    specimen = design.draw_specimen(seed, planned.medium, planned.specimen, population)
    deviations = design.draw_deviations(seed, planned)
    return SyntheticInsertion(
        planned, specimen, deviations, insert_needle(planned, design.draw_needle(seed), specimen, deviations)
    )
