"""Where the needle first touched the tissue, from what is stated and what the scan shows."""

import numpy as np

from needlefit.errors import DataError
from needlefit.geometry.crossings import surface_hits
from needlefit.geometry.curves import arc_length
from needlefit.geometry.surfaces import Surface
from needlefit.imaging import entry
from needlefit.imaging.profile import tissue_edge
from needlefit.imaging.reconstruction import EntryPose
from needlefit.imaging.remarks import BEYOND
from needlefit.imaging.scan import Scan
from needlefit.imaging.seen import Seen
from needlefit.project.records.reconstruction import ReconstructionRecord


def first_contact(
    seen: Seen, scan: Scan, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[EntryPose, EntryPose | None]:
    """Return the entry pose, and the one of the shaft outside the tissue where it shows."""
    if scan.stage is None:
        at, at_sd = _tissue(seen, scan, surfaces, recipe)
        shaft = entry.on_surface(entry.from_shaft(_shaft(seen, scan, recipe, at), at_sd), surfaces)
        return shaft, shaft
    (here,) = seen.patient.to_local(scan.stage.entry[None])
    stage = entry.from_stage(scan.stage, seen.registration, here)
    outside = _shaft(seen, scan, recipe, entry.start(seen.world, stage))
    if entry.shown(outside) < entry.SHORTEST_SHAFT:
        return stage, None
    other = entry.from_shaft(outside, stage.along_sd)
    entry.require_agreement(stage, other)
    return stage, other


def _shaft(seen: Seen, scan: Scan, recipe: ReconstructionRecord, at: float) -> entry.Shaft:
    """Return the needle before `at` (mm along it), where it enters the tissue."""
    world = seen.world
    s = arc_length(world)
    base = recipe.needle.length_mm - (s[-1] - at)
    return entry.Shaft(
        points=world[s < at],
        sd=seen.traced.sd[s < at],
        s=s[s < at] - at,
        free=base if scan.guide_distance is None else scan.guide_distance,
        bend=recipe.entry.bend_mm,
        turn=np.radians(recipe.entry.bend_deg),
    )


def _tissue(
    seen: Seen, scan: Scan, surfaces: tuple[Surface, ...], recipe: ReconstructionRecord
) -> tuple[float, float]:
    """Return where along the whole needle the tissue begins, and how sure that is, mm.

    The tissue's own surface says it where there is one, else the change of brightness around the needle.
    """
    outer = [surface for surface in surfaces if surface.into == 1]
    hits = np.concatenate([surface_hits(seen.world, surface) for surface in outer]) if outer else np.empty(0)
    edge = tissue_edge(seen.profile)
    if len(hits):
        at = float(hits.min())
        _refuse_elsewhere(at, edge, scan)
        return at, recipe.layers.surface_sd_mm
    if edge is None:
        raise DataError(
            "the scan does not show where the needle enters the tissue",
            where=str(scan.volume),
            expected="air before the tissue along the needle, the tissue's surface (into = 1), or the stage",
            mend="state the stage (entry_x_mm ... pose_angle_sd_deg), or add the tissue's own surface to the "
            "layers, as FILE=sheet:1 or FILE=solid:1",
        )
    return edge


def _refuse_elsewhere(at: float, edge: tuple[float, float] | None, scan: Scan) -> None:
    """Refuse a tissue whose own surface the needle meets (`at`) far from where the scan shows it to begin."""
    if edge is None or abs(at - edge[0]) <= entry.FARTHEST + BEYOND * edge[1]:
        return
    side = "behind" if at > edge[0] else "before"
    raise DataError(
        f"the needle crosses the tissue's own surface {abs(at - edge[0]):.1f} mm {side} the place where the "
        "scan shows tissue to begin",
        where=str(scan.volume),
        expected=f"within {entry.FARTHEST:g} mm of it",
        mend="see both in 3D Slicer: label the needle's voxels as the tissue around them, check the frame of "
        "the surfaces; if they are right, state the stage (entry_x_mm ... pose_angle_sd_deg)",
    )
