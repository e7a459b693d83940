"""Run the studies on many twins: the distribution of every cell, and which methods the fit beats.

This is the twin's consistency, not evidence for the model. Every seed draws needle, specimens, noise and
registration anew; the plan of insertions stays. `one_twin` carries out all studies and fits on one of them;
`run` compares the fit with the other methods, and says why it loses where it does.
"""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.seeds.schema import SeedsRecord

KIND = StudyKind("seeds", SeedsRecord, __name__)
