"""Measure what a new specimen costs: errors on held-out needles against the number of insertions fitted to.

Three approaches to the new medium are scored on one fixed set of held-out needles, through the layers of
their planned paths. "Inflated": the posterior of the old medium, widened by how much media differ
(`inference.transferred_prior`), is the prior, and new insertions update it. "New": new insertions alone, from
the new medium's bounds. "None": the old model as it is. Errors are those of the best fit, as in the tables of
studies; the CRPS and the intervals are of draws of the posterior.
"""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.adaptation.schema import AdaptationRecord

KIND = StudyKind("adaptation", AdaptationRecord, __name__)
