"""What the reconstruction takes as given of scanners, needles and tissue, by its physical meaning.

Each value has the unit of its class, and its source: a definition, a reason, or the volumes that set it. [R]:
the part `tuning` of `benchmarks/real_scanners.py`, and `benchmarks/reconstruction.py`; [S]: its `--seeds` of
14060 and below; [G]: `--guides 0:8, 500:517`. Steps and tolerances of an algorithm stand beside it.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Known:
    """What is known of a quantity before it is fitted: a value, the deviation of its logarithm, its range."""

    value: float
    sd: float
    range: tuple[float, float] = (0.0, np.inf)


class SCANNER:
    """The point spread of scanners, and what a beam does in metal."""

    BLUR = Known(0.45, 0.3, (0.15, 1.2))  # in the slices, mm [R]
    BOOST = Known(0.5, 1.0, (-0.2, 5.0))  # of middle frequencies, by kernels; the deviation is its own [R]
    # Across slices, over their distance: a box has 0.29, helical scans more; range, mm, also along needles
    SLICE_BLUR = Known(0.33, 0.5, (0.1, 2.0))
    METAL = Known(20_000.0, 0.7)  # HU: titanium has 8 000, steel 30 000, hardened 15 000
    BALL = Known(1e4, 1.0, (10.0, 1e5))  # HU: glass or metal
    ATTENUATION = Known(0.75, 0.25)  # of the needle, 1/mm
    HARDENING = Known(0.3, 0.35)  # relative variance of the attenuation over the spectrum
    SCATTER = Known(0.012, 0.6)  # over the open beam
    LINEARITY = Known(1.0, 0.3)  # of the slices over a scanner's


class HU:
    """Values of a scan, HU."""

    AIR = -1000.0  # by the definition of HU
    AIR_RANGE = (-1100.0, -900.0)  # of calibrated scanners; cone beams leave it
    GAP = -250.0  # fat has -120 and is brighter; air that blur fills half is darker
    LIGHT = -600.0  # foam and lung are brighter, air is darker
    # Fat to connective tissue (Schneider 2000, doi:10.1088/0031-9155/45/2/314), near metal darker
    SOFT_TISSUE = (-150.0, 100.0)
    GUIDE_STEP = 50.0  # change behind a guide as bright as tissue; layers of gels differ by less
    STEP = 20.0  # least change that begins another material, and of air in a narrow gap from its level [R]
    METAL = 1000.0  # bone of a hand is darker, metal and glass are brighter
    METAL_CONTRAST = METAL / 2  # half of the way from tissue to metal, or from air to tissue: as edges show
    HUB = 1500.0  # of a metal hub, least [S]
    CLIPPED = 3071.0  # the largest number of 12 bits; streaks beyond a tip are less bright or dark


class MM:
    """Lengths, mm."""

    STATION = 0.5  # between cross-sections: a voxel of a cone beam
    PATCH = 2.4  # radius of what is looked at around the needle: its blur ends there, and segments spare it
    KNOT = 7.5  # of the axis: needles in gels bend over longer lengths [R]
    RING = (3.5, 6.0)  # of the surroundings: beyond bloom, within the nearest marker as a rule
    # Where blur shows, four deviations of a wide one: a streak beyond the tip fades there; over twice that to
    # either side edges are fitted, and air in narrower gaps has no level
    BLUR_REACH = 2.0
    # Within which voxels show one thing: of two changes the larger counts, the shaft outside begins there,
    # and a tip this near to the volume's face may lie outside
    BLUR_CORE = BLUR_REACH / 2
    # Within which the blur of an edge shows: thinner guides show no step, a needle is faint, a base this near
    # to the volume's face, or a tip along its course, has left it, and so far behind its bevel its tip is
    # fitted
    EDGE_BLUR = 3.0
    REACH = 80.0  # along the needle to the tissue's surface, or to a hub
    # Of what a scanner shows of an end, which the model does not: of a tip, across it, and of edges
    MODEL_SD = 0.05  # [R] [G]
    # Of a face of metal, and of the end of a guide that is not stated, which a film of air moves by 0.5 mm at
    # most
    HIDDEN_FACE_SD = 0.5 / 12**0.5
    # To either side of an edge: within it a place, or a thickness, is the one that is stated, or seen
    # otherwise, and the blur of air or metal shows
    MATCH = EDGE_BLUR / 2
    BEVEL_MARGIN = PATCH / 2  # by which a needle may look shorter at its end: half of where its blur ends
    GRID_SD = 0.005  # of an axis or a ball, that no scatter shows: the voxel grid, rays [R]
    # Beyond a needle's end, where it is looked for: in slices with 4 mm one of 9 tips moved by 0.17 mm [S]
    BEYOND_END = 5.0
    # Least length of a needle in the scan; so far from a hub it shows the hub's direction, and so much of one
    # that leaves the volume is beyond its face
    NEEDLE_LENGTH = 20.0
    HUB_RADIUS = 5.0  # largest
    HUB_LENGTH = 4.0  # least; so much of it shows its axis
    SHAFT_LENGTH = 5.0  # least, outside the tissue, that shows an axis
    LABEL_SMOOTHING = 0.5  # deviation, of the boundary of a segmentation
    RIM = PATCH - STATION  # from the needle, where its surroundings begin: the last voxel of the patch
    DARK = 6.0  # of a needle that rays darken, at most; longer rays show themselves rather than the bevel [R]
    END_MOMENT = 5.0  # lever of the shear force at the end: the tip itself carries no moment
    # Of a needle that rays hide, at its end, behind a hub, or between two pieces: its spline goes on [R]
    HIDDEN = 2 * KNOT
    SWING_SD = 0.1  # by which a needle leaves its shaft's course within its bevel
    LEAST_SLICE_BLUR = 0.2  # of scanners, across slices
    STREAK_RADIUS = 0.8  # deviation of a streak across [R]
    TIP_DOUBT = 0.3  # deviation of the tip along, or along the slices' normal, that is spoken of


class PART:
    """Fractions and factors, without a unit."""

    WIDENING = 2.5  # width of a needle's image over its own [R]
    SECOND_NEEDLE = 0.6  # of the longest one's length and brightness
    DIVIDED_NEEDLE = 0.4  # the same, where all needles are wanted
    CLEAR = 1.5  # of two widths, or soft lengths, that are not of one thing
    BALL_DIAMETER = 1.5  # of a ball over that of as many voxels, at most
    # Of the way from tissue to metal; the last where a plate hangs together with the needle
    THRESHOLDS = (0.4, 0.25, 0.15, 0.08, 0.7)
    BRIGHTEST = 0.97  # of the brightest of something, beyond which all is as bright
    FAINT = 0.3  # of a needle's brightness: fainter sections show none
    FIRST_NOISE = 0.05  # of a ball's brightness, before the noise is known
    SHOWN = 0.5  # of a cross-section in the volume, and of the way between points on which a needle shows
    REFUSED_MISFIT = 0.32  # of an end's image: needles alone have 0.31 at most, with a ball at the end 0.33
    END_MISFIT = 0.14  # of an end's image, that is spoken of
    SLICE_MISFIT = 0.35  # of slices that are fitted as a whole, that is spoken of [S]
    # Of such slices, that is refused: an axis at 2.4 was 4.9 mm off, those at 1.0 to 1.5 by 0.2 to 0.7 [S]
    REFUSED_SLICES = 2.0
    FLATNESS = 1.15  # voxels' length over width of a scanner's slices; those of cone beams are cubes
    HUB_RADIUS = 1.8  # least, over the needle's diameter
    BOX = 0.8  # of the variance of a slice's profile: the rest is a Gaussian's
    SIGNAL_ERROR = 0.04  # of what a voxel shows of metal: the model's own error [R]
    # Of the voxels' spacing along the needle, at its tip: of ten volumes of [G] errors are 0.92 of what this
    # states, in root mean square
    TIP_SD = 0.11
    # Of a fitted bevel over that of the stated one: wrong ones 0.85 at most, right ones 0.99 at least
    BEVEL_MISFIT = 0.9
    BALL_MISFIT_SD = 0.35  # of its blur, per misfit [R]
    # Of the distance of slices, for a needle in them; of its square over the radius, for a ball [R] [S]
    SLICE_SD = 0.02
    AIR_VOXELS = 0.02  # of a scan's voxels, that are as dark as air: fewer do not count
    ISLANDS = 0.02  # of a layer's volume in these, and in cavities: less does not count
    TOLERANCE = 1e-3  # of a fit's cost and parameters, at which it ends: an end moves by less than 0.01 mm


class PROBABILITY:
    """Probabilities of an error that is tolerated."""

    # That noise as stated makes the right pairing of markers look too bad, shows a step where there is none,
    # or makes another pairing look right
    FALSE_ALARM = 1e-4


class SD:
    """Numbers of standard deviations."""

    OUTLIER = 1.5  # beyond which a residual counts less, and a click is not on its marker
    DISAGREEMENT = 3.0  # beyond which two statements of one quantity disagree
