"""What a person should know of a registration that was accepted."""

import numpy as np

from needlefit.geometry.frames import Frame
from needlefit.imaging.registration.icp import icp
from needlefit.imaging.registration.marker_sets import MarkerSets, mirrored
from needlefit.imaging.registration.pairing import GAP, Pairing
from needlefit.imaging.registration.rigid import align
from needlefit.imaging.registration.scale import NOTICED, Scale

TURNED = 30.0
"""Degrees by which a pose may differ from the rough one without a word."""


def remarks(
    sets: MarkerSets, chosen: Pairing, suggested: tuple[Scale, ...], rough: Frame | None
) -> tuple[str, ...]:
    """Return the remarks on a pairing, in the order in which they matter."""
    return (
        *_unpaired(sets, chosen),
        *_scaled(suggested),
        *_flat(sets, chosen),
        *_untried(chosen),
        *(_rough(sets, chosen, rough) if rough is not None else ()),
    )


def _unpaired(sets: MarkerSets, chosen: Pairing) -> list[str]:
    found = np.setdiff1d(np.arange(len(sets.found)), chosen.best.pairs[:, 0])
    known = np.setdiff1d(np.arange(len(sets.known)), chosen.best.pairs[:, 1])
    notes = []
    if found.size:
        notes.append(f"found markers {_listed(found)} (counted from 0) belong to no known one")
    if known.size:
        notes.append(f"known markers {_listed(known)} (counted from 0) were not found")
    here = chosen.best.alignment.frame.to_world(sets.found[found])
    for i, place in zip(found, here, strict=True):
        away = np.linalg.norm(sets.known[known] - place, axis=1)
        if away.size and away.min() < 0.1 * sets.extent:
            notes.append(
                f"found marker {i} lies {away.min():.2f} mm from known marker {known[np.argmin(away)]}: "
                "one of them has moved, or is measured wrongly"
            )
    return notes


def _scaled(suggested: tuple[Scale, ...]) -> list[str]:
    worst = max(suggested, key=lambda one: one.significance, default=None)
    if worst is None or worst.significance <= NOTICED:
        return []
    return [
        f"the scan would have to be stretched {worst.along} by {worst.factor:.4f} +- {worst.sd:.4f}, which "
        "was not done: check the voxel spacing"
    ]


def _flat(sets: MarkerSets, chosen: Pairing) -> list[str]:
    """Say if the paired markers would fit a mirrored scan nearly as well, as flat layouts always do."""
    reflected = align(mirrored(sets), chosen.best.pairs)
    if reflected.chi2 - chosen.best.alignment.chi2 > GAP:
        return []
    return ["the paired markers are flat within the noise: a mirrored scan would pass unseen"]


def _untried(chosen: Pairing) -> list[str]:
    if np.isnan(chosen.doubt):
        return ["too many pairings to try them all: the pairs come from closest points and the rough pose"]
    if chosen.rivals and chosen.doubt > 1e-2:
        return ["other pairings fit as well; the one given was taken"]
    return []


def _rough(sets: MarkerSets, chosen: Pairing, rough: Frame) -> list[str]:
    notes = []
    rotation = chosen.best.alignment.frame.rotation @ rough.rotation.T
    angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    if angle > TURNED:
        notes.append(f"the pose found is turned by {angle:.0f} degrees against the rough one")
    closest = icp(sets, rough)
    pairs = chosen.best.pairs
    order = np.argsort(pairs[:, 0])
    if not np.array_equal(closest, pairs[order]):
        notes.append("closest points from the rough pose end in another, worse pairing")
    return notes


def _listed(numbers: np.ndarray) -> str:
    return ", ".join(map(str, numbers.tolist()))
