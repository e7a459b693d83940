"""Check a reconstruction: errors for layers that cannot be right, and warnings for the user."""

from collections.abc import Iterator, Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.crossings import find_crossings, find_surface_hits, measure_enclosed_length
from needlefit.geometry.frames import AXIS_SIGNS, Frame
from needlefit.geometry.surfaces import Surface, find_nearest, transform_surface
from needlefit.imaging.entry import compare_poses
from needlefit.imaging.materials import find_tissue_edge
from needlefit.imaging.needle.tip import END_LENGTH_MM
from needlefit.imaging.reconstruction import Layers, Reconstruction
from needlefit.imaging.refusals import refusal
from needlefit.imaging.scans import Scan

MIN_P_VALUE = 0.01  # residuals of markers that the stated noise leaves less often are spoken of
MAX_DISAGREEMENT_SD = 3.0  # deviations from which on two ways to the same quantity disagree
# Degrees between the stated bevel and the one seen from which on something was mixed up.
MAX_BEVEL_ANGLE_DEG = 30.0
MAX_PLANE_SD_DEG = 20.0  # deviation of the bending plane, degrees, from which on a shape does not tell it
MAX_TIP_SD_MM = 0.5  # deviation of the tip along the needle, mm, that is spoken of
# Length of the needle along which rays run that hide its end, mm, that is spoken of: with less no tip is off
# by more than 0.4 mm on the part `tuning` of `benchmarks/real_scanners.py`.
MAX_HIDDEN_LENGTH_MM = 12.0
TIP_CLEARANCE_MM = 2.0  # distance from the tip, mm, from which on its blur does not show
MAX_DEPTH_SD_MM = 2.0  # deviation of the inserted length, mm, beyond which a scan is refused
# Deviation of a layer's depth, mm, that is spoken of; the tip's deflection hangs on it steeply.
MAX_LAYER_SD_MM = 0.5


def collect_warnings(one: Reconstruction, earlier: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the warnings about a reconstruction, the most important first: its tip, then `earlier` ones.

    DataError if the inserted length is not known to `MAX_DEPTH_SD_MM`.
    """
    if one.depth_sd > MAX_DEPTH_SD_MM:
        tip, entry = float(one.needle_axis.tip_sd[0]), one.pose.along_sd
        raise refusal(f"""the inserted length is known to +- {one.depth_sd:.2g} mm only (tip {tip:.2g}, entry
                {entry:.2g})
            expected: +- {MAX_DEPTH_SD_MM:g} mm or less
            fix: state the stage or the tissue's own surface (into = 1) if the entry is not known; if the tip
                is not, scan it away from other metal, or with thinner slices""")
    return (
        *list_tip_warnings(one),
        *earlier,
        *(() if one.markers is None else one.markers.warnings),
        *(() if one.registration is None else one.registration.warnings),
        *_input_warnings(one),
        *_entry_warnings(one),
        *_plane_warnings(one),
        *_doubt_warnings(one),
    )


def list_tip_warnings(one: Reconstruction) -> list[str]:
    """Return what a person should know of the needle's end."""
    needle, notes = one.needle_axis, []
    sd = f"+- {float(needle.tip_sd[0]):.2f} mm"
    if needle.tip_source == "threshold":
        notes.append(
            "the model of the needle's end does not explain the scan: the tip is taken where a threshold "
            f"sees it, {needle.tip_disagreement:+.2f} mm from there, {sd} along the needle"
        )
    elif needle.hidden_length > MAX_HIDDEN_LENGTH_MM:
        notes.append(
            f"rays run along {needle.hidden_length:.0f} mm of the needle, which lies in the slices, and may "
            f"hide its end: {sd} along the needle, and some are 2 mm off and more; look at it, or "
            "scan the needle across the slices"
        )
    elif needle.tip_sd[0] > MAX_TIP_SD_MM:
        notes.append(f"the tip is known to {sd} only along the needle")
    if (further := _find_metal_beyond(one)) is not None:
        notes.append(
            f"{further:.1f} mm beyond the tip found, on the needle's axis, something is as bright as the "
            "needle: rays may hide a part of it, and the tip lie further on; look at it"
        )
    return notes


def _find_metal_beyond(one: Reconstruction) -> float | None:
    """Return how far beyond the tip the axis meets metal again, mm; None if it does not."""
    profile = one.profile
    excess = profile.core - profile.around
    shaft = excess[(profile.s > one.depth - END_LENGTH_MM) & (profile.s < one.depth - TIP_CLEARANCE_MM)]
    beyond = profile.s > one.depth + TIP_CLEARANCE_MM
    if not np.isfinite(shaft).any():
        return None
    bright = np.flatnonzero(beyond & (excess > np.nanmedian(shaft) / 2))
    return float(profile.s[bright[0]] - one.depth) if len(bright) else None


def _input_warnings(one: Reconstruction) -> Iterator[str]:
    """Yield what there is to say of the markers' deviations, and of what a person placed."""
    known, scan = one.registration, one.scan
    if known is not None and known.p_value <= MIN_P_VALUE:
        yield (
            f"the markers miss their places by {known.fre:.2f} mm, {known.expected_fre:.2f} were expected "
            f"(probability {known.p_value:.1g}): the stated deviations are too small, or a marker has moved"
        )
    placed = {
        "the needle": scan.needle_at,
        "the markers": scan.fiducials,
        "the first contact": scan.contact,
        "the tip": scan.tip,
    }
    by_hand = [name for name, given in placed.items() if given is not None]
    if by_hand:
        yield f"placed by hand in the scan: {', '.join(by_hand)}"


def _entry_warnings(one: Reconstruction) -> Iterator[str]:
    at_tip = float(np.hypot(one.pose.shift_sd, one.pose.angle_sd * one.depth))
    if one.pose.source == "shaft":
        yield (
            f"the entry axis is drawn through the shaft outside the tissue: +- {at_tip:.2f} mm at the tip's "
            "depth; the stage's axis is more accurate, where it is known"
        )
    elif one.shaft is not None:
        apart = compare_poses(one.pose, one.shaft)
        if apart.worst > MAX_DISAGREEMENT_SD:
            yield apart.sentence
    edge, source = find_tissue_edge(one.profile), _describe_entry_source(one)
    if edge is None or source is None:
        return
    off, sd = edge[0], float(np.hypot(edge[1], one.pose.along_sd))
    if abs(off) > MAX_DISAGREEMENT_SD * sd:
        side = "after" if off > 0 else "before"
        yield f"in the scan the tissue begins {abs(off):.2f} +- {sd:.2f} mm {side} {source}"


def _describe_entry_source(one: Reconstruction) -> str | None:
    """Return what says where the tissue begins; None if that is the brightness of the scan itself."""
    if one.pose.source == "stage":
        return "the stage's entry"
    own = any(surface.into == 1 for surface in one.layers.surfaces)
    return "its own surface (into = 1)" if own else None


def _plane_warnings(one: Reconstruction) -> Iterator[str]:
    local = one.local
    deflection, aside = float(local[-1, 1]), float(np.abs(local[:, 2]).max())
    error = float(np.hypot(one.sd[-1], np.hypot(one.pose.shift_sd, one.pose.angle_sd * one.depth)))
    if one.plane == "shape" and np.degrees(error) > MAX_PLANE_SD_DEG * abs(deflection):
        yield (
            f"the tip lies {abs(deflection):.2f} +- {error:.2f} mm beside the entry axis: so straight, "
            "it determines no bending plane, and its deflection is biased upward; state the bevel's direction"
        )
    elif one.plane != "shape" and aside > MAX_DISAGREEMENT_SD * error and aside > abs(deflection) / 3:
        yield (
            f"the needle leaves the bending plane by {aside:.2f} mm, and bends {abs(deflection):.2f} in it: "
            "check the bevel's direction"
        )
    visible_bevel = one.patient.rotation @ one.needle_axis.bevel
    if one.plane == "stated" and np.isfinite(visible_bevel).all():
        facing = one.scan.side * one.frame.rotation[:, 1]
        across = visible_bevel - (visible_bevel @ one.frame.rotation[:, 0]) * one.frame.rotation[:, 0]
        angle = np.degrees(np.arccos(np.clip(facing @ across / np.linalg.norm(across), -1, 1)))
        if angle > MAX_BEVEL_ANGLE_DEG:
            yield f"the bevel seen at the tip points {angle:.0f} degrees away from the one stated"


def _doubt_warnings(one: Reconstruction) -> Iterator[str]:
    """Yield which layers are poorly known, and that the bevel's side is."""
    depths = zip(one.layers.boundaries, one.layers.sd, strict=True)
    steep = [f"{depth:.2f} +- {sd:.2f} mm" for depth, sd in depths if sd > MAX_LAYER_SD_MM]
    if steep:
        yield f"layer depths that are poorly known: {', '.join(steep)}"
    probability, seen = one.needle_axis.bevel_probability, np.isfinite(one.needle_axis.bevel).all()
    if np.isfinite(probability) and not seen and one.plane != "stated":
        yield f"the scan does not show the bevel's side (probability {probability:.2f}): it is left open"


TUNNEL_RADIUS_MM = 2.0
# A surface runs along a needle from this length on, mm: no ball of that radius is passed through so long.
MIN_TUNNEL_LENGTH_MM = 2 * TUNNEL_RADIUS_MM


def refuse_tunnels(surfaces: Sequence[Surface], needle: Floats) -> None:
    """Refuse layers that were drawn around a needle (N, 3), world, from base to tip.

    Where metal was left out of a segmentation, the needle lies in a tunnel of each layer, and crosses their
    surfaces where the tunnels end: anywhere.

    DataError if a surface, the tissue's own or another, runs around the needle.
    """
    lengths = [
        (surface.name, measure_enclosed_length(needle, surface, TUNNEL_RADIUS_MM)) for surface in surfaces
    ]
    around = [f"{name} (along {length:.0f} mm)" for name, length in lengths if length >= MIN_TUNNEL_LENGTH_MM]
    if around:
        raise refusal(f"""the layers run around the needle, so that it does not cross them:
                {", ".join(around)}
            expected: surfaces that the needle passes through
            fix: label the needle's voxels as the tissue around them, e.g. in 3D Slicer's Segment Editor by
                Smoothing, Closing (fill holes), with a kernel wider than the needle, for each layer""")


def check_layer_count(scan: Scan, layers: Layers, points: Floats, patient: Frame) -> tuple[str, ...]:
    """Return warnings about the number of layers that a needle (N, 3), world, crosses.

    Nothing, where there are as many as somebody counted.

    `patient`: the scan's LPS axes and origin in the world.

    DataError if somebody counted the layers and these are not as many.
    """
    counted = {number for number in (scan.layers, scan.layers_alternative) if number is not None}
    if len(layers.sequence) in counted:
        return ()
    notes = tuple(_crossing_warnings(layers, points, patient))
    if not counted:
        return notes
    depths = ", ".join(f"{depth:.2f}" for depth in layers.boundaries)
    where = f"; interfaces at {depths} mm" if depths else ""
    order = " > ".join(map(str, layers.sequence))
    expected = " or ".join(map(str, sorted(counted)))
    raise refusal(f"""{scan.id} meets {len(layers.sequence)} layer{"s" * bool(depths)} ({order}{where}), but
            {expected} were counted{"".join(f"; {one}" for one in notes)}
        expected: {expected} layers
        fix: correct the count or the surfaces; look at both together in 3D Slicer""")


def _crossing_warnings(layers: Layers, points: Floats, patient: Frame) -> Iterator[str]:
    for surface in layers.surfaces:
        if surface.kind == "sheet" and not len(find_surface_hits(points, surface)):
            beside = _distance_beside(points, surface)
            if beside is not None:
                yield f"the needle passes {beside:.1f} mm beside the sheet {surface.name}: it is too small"
    beyond = [surface for surface in layers.surfaces if surface.into > 1]
    if beyond and not len(layers.boundaries):
        away = find_nearest(points, beyond).distances
        yield f"the needle crosses no layer; the nearest surface stays {away.min():.1f} mm away"
        turn = patient.rotation @ np.diag(AXIS_SIGNS["RAS"]) @ patient.rotation.T
        turned = Frame(patient.origin - turn @ patient.origin, turn)
        flipped = [transform_surface(surface, turned) for surface in layers.surfaces]
        if len(find_crossings(points, flipped).sequence) > 1:
            yield "the needle would cross layers if their files were in RAS: save them in LPS"


def _distance_beside(points: Floats, surface: Surface) -> float | None:
    """Return how far from a sheet a needle goes through its mean plane, mm; None if it does not."""
    vertices = np.asarray(surface.mesh.vertices, dtype=np.float64)
    centre = vertices.mean(axis=0)
    normal = np.linalg.svd(vertices - centre, full_matrices=False)[2][2]
    heights = (points - centre) @ normal
    passes = np.flatnonzero(np.signbit(heights[1:]) != np.signbit(heights[:-1]))
    if len(passes) == 0:
        return None
    n = int(passes[0])
    part = heights[n] / (heights[n] - heights[n + 1])
    place = points[n] + part * (points[n + 1] - points[n])
    return float(find_nearest(place, [surface]).distances[0])
