"""What a person should know of a reconstruction that passed."""

import numpy as np

from needlefit.imaging.entry import disagreement
from needlefit.imaging.profile import tissue_edge
from needlefit.imaging.reconstruction import Reconstruction

UNLIKELY = 0.01
"""Residuals of markers that the stated noise leaves less often are spoken of."""

BEYOND = 3.0
"""Deviations from which on two ways to the same quantity disagree."""

TURNED = 30.0
"""Degrees between the stated bevel and the one seen from which on something was mixed up."""

UNSURE_PLANE = 20.0
"""Deviation of the bending plane, degrees, from which on a shape does not tell it."""

STEEP = 0.5
"""Deviation of a layer's depth, mm, that is spoken of; the tip's deflection hangs on it steeply."""


def remarks(one: Reconstruction) -> tuple[str, ...]:
    """Return the remarks, in the order in which they matter."""
    found = () if one.registration is None else one.registration.remarks
    return (*found, *_misfit(one), *_entry(one), *_plane(one), *_layers(one))


def _misfit(one: Reconstruction) -> list[str]:
    known = one.registration
    if known is None or known.chance > UNLIKELY:
        return []
    return [
        f"the markers miss their places by {known.fre:.2f} mm, {known.expected_fre:.2f} were expected "
        f"(probability {known.chance:.1g}): the stated deviations are too small, or a marker has moved"
    ]


def _entry(one: Reconstruction) -> list[str]:
    notes = []
    at_tip = float(np.hypot(one.pose.shift_sd, one.pose.angle_sd * one.depth))
    if one.pose.source == "shaft":
        notes.append(
            f"the entry axis is drawn through the shaft outside the tissue: +- {at_tip:.2f} mm at the tip's "
            "depth; the stage's axis, where it is known, is surer"
        )
    if one.pose.source == "stage" and one.shaft is not None:
        apart = disagreement(one.pose, one.shaft)
        notes += [apart.said] if apart.worst > BEYOND else []
    edge, told = tissue_edge(one.profile), _entry_from(one)
    if edge is None or told is None:
        return notes
    off, sd = edge[0], float(np.hypot(edge[1], one.pose.along_sd))
    if abs(off) > BEYOND * sd:
        side = "after" if off > 0 else "before"
        notes.append(f"in the scan the tissue begins {abs(off):.2f} +- {sd:.2f} mm {side} {told}")
    return notes


def _entry_from(one: Reconstruction) -> str | None:
    """Return what says where the tissue begins; None if that is the brightness of the scan itself."""
    if one.pose.source == "stage":
        return "the stage's entry"
    own = any(surface.into == 1 for surface in one.layers.surfaces)
    return "its own surface (into = 1)" if own else None


def _plane(one: Reconstruction) -> list[str]:
    notes = []
    local = one.local
    deflection, aside = float(local[-1, 1]), float(np.abs(local[:, 2]).max())
    error = float(np.hypot(one.sd[-1], np.hypot(one.pose.shift_sd, one.pose.angle_sd * one.depth)))
    if one.plane == "shape" and np.degrees(error) > UNSURE_PLANE * abs(deflection):
        notes.append(
            f"the tip lies {abs(deflection):.2f} +- {error:.2f} mm beside the entry axis: so straight, "
            "it tells no bending plane, and its deflection is biased upward; state the bevel's direction"
        )
    elif one.plane != "shape" and aside > BEYOND * error and aside > abs(deflection) / 3:
        notes.append(
            f"the needle leaves the bending plane by {aside:.2f} mm, and bends {abs(deflection):.2f} in it: "
            "check the bevel's direction"
        )
    seen = one.patient.rotation @ one.traced.bevel
    if one.plane == "stated" and np.isfinite(seen).all():
        facing = one.scan.side * one.frame.rotation[:, 1]
        across = seen - (seen @ one.frame.rotation[:, 0]) * one.frame.rotation[:, 0]
        angle = np.degrees(np.arccos(np.clip(facing @ across / np.linalg.norm(across), -1, 1)))
        if angle > TURNED:
            notes.append(f"the bevel seen at the tip points {angle:.0f} degrees away from the one stated")
    return notes


def _layers(one: Reconstruction) -> list[str]:
    steep = [
        f"{depth:.2f} +- {sd:.2f} mm"
        for depth, sd in zip(one.layers.boundaries, one.layers.sd, strict=True)
        if sd > STEEP
    ]
    if not steep:
        return []
    return [f"layer depths that are poorly known: {', '.join(steep)}"]
