"""Reconstructions put together by hand from synthetic scans, without the verb that does it."""

import dataclasses
from functools import cache
from pathlib import Path

import ct_cases
import numpy as np

from needlefit.geometry.crossings import find_crossings
from needlefit.geometry.curves import arc_length, find_bending_direction, interpolate_at_arc
from needlefit.geometry.frames import IDENTITY_FRAME, Frame, make_entry_frame, normalize
from needlefit.geometry.surfaces import make_sheet, transform_surface
from needlefit.imaging.materials import find_rises, sample_profile
from needlefit.imaging.needle.centerline import trace_needle
from needlefit.imaging.needle.segmentation import select_needle
from needlefit.imaging.reconstruction import EntryPose, Layers, MarkerResult, Reconstruction, render_views
from needlefit.imaging.registration.register import predict_mean_target_error, register, scan_frame
from needlefit.imaging.scans import Scan

PATIENT = Frame(
    np.array([-40.0, 22.0, 310.0]), np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
)
"""The scan's axes and origin in the world of the markers."""

MARKERS = np.array(
    [[3.0, 4, 18], [19, 3, 22], [4, 18, 31], [17, 19, 38], [20, 9, 44], [2, 11, 47]]
)  # LPS; the last is not found
MARKER_SD = 0.08


@cache
def small_scan(toward=(0.0, 3.0)):
    """A scan of 22 x 22 x 50 mm: the needle enters at S = 12 mm, its tip moves `toward` (L, P) at 40 mm."""
    return ct_cases.scan(ct_cases.axis(curve=toward))


@cache
def small(markers=True, layers=True):
    """A reconstruction of `small_scan`; its boundary lies 14 mm deep."""
    volume = small_scan()
    box = ct_cases.box()
    into = box.rotation[:, 0]
    boundary = make_sheet("interface1", box.to_world([[14.0, 0, 0]])[0], into, 60.0, into=2)
    scan = Scan("phantom1-03", Path("scans/phantom1-03.nrrd"), "phantom1", "box 2", origin="synthetic")
    known = MARKERS if markers else None
    return reconstruct(scan, volume, known, (boundary,) if layers else ())


def reconstruct(scan, volume, markers, surfaces, seed=5):
    """A reconstruction of a needle; `markers` (LPS, the last is not found) and `surfaces` lie in the scan."""
    needle_axis = trace_needle(volume, select_needle(volume, ct_cases.RECIPE).needle, ct_cases.RECIPE)
    found, registration, patient = None, None, IDENTITY_FRAME
    if markers is not None:
        rng = np.random.default_rng(seed)
        centers = markers[:-1] + MARKER_SD * rng.normal(size=(len(markers) - 1, 3))
        registration = register(centers, PATIENT.to_world(markers), MARKER_SD)
        found = MarkerResult(centers, np.full(len(centers), MARKER_SD), "volume")
        patient = scan_frame(registration)
    s = arc_length(needle_axis.points)
    beyond = np.arange(0.5, 8.0, 0.5)
    forward = normalize(needle_axis.points[-1] - needle_axis.points[-4])
    along = np.vstack([needle_axis.points, needle_axis.points[-1] + beyond[:, None] * forward])
    shown = sample_profile(volume, along, np.concatenate([s, s[-1] + beyond]))
    _, entry, entry_sd = find_rises(shown)[-1]
    shown = dataclasses.replace(shown, s=shown.s - entry)
    inserted = interpolate_at_arc(needle_axis.points, np.linspace(entry, s[-1], 60))
    points = patient.to_world(inserted)
    shaft = patient.to_world(interpolate_at_arc(needle_axis.points, [0.0, entry]))
    direction = normalize(shaft[1] - shaft[0])
    frame = make_entry_frame(points[0], direction, find_bending_direction(points, direction))
    placed = tuple(transform_surface(surface, patient) for surface in surfaces)
    met = find_crossings(points, placed)
    depths = frame.to_local(met.points)[:, 0]
    ends = np.zeros(2) if registration is None else predict_mean_target_error(registration, inserted[[0, -1]])
    return Reconstruction(
        scan=scan,
        spacing=volume.spacing,
        needle_axis=needle_axis,
        markers=found,
        registration=registration,
        patient=patient,
        pose=EntryPose(points[0], direction, "shaft", 0.04, 0.004, entry_sd),
        shaft=EntryPose(points[0], direction, "shaft", 0.04, 0.004, entry_sd),
        frame=frame,
        plane="shape",
        points=points,
        sd=np.interp(np.linspace(entry, s[-1], 60), s, needle_axis.sd),
        depth=float(s[-1] - entry),
        depth_sd=float(np.hypot(entry_sd, needle_axis.tip_sd[0])),
        target_error=ends,
        layers=Layers(placed, depths, np.full(len(depths), 0.12), met.points, met.sequence),
        profile=shown,
        views=render_views(volume, patient, frame, needle_axis.points),
        warnings=() if registration is None else registration.warnings,
    )
