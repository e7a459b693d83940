"""Plan an insertion: where to enter, and how deep, to reach a target."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.plan.schema import PlanRecord

KIND = StudyKind("plan", PlanRecord, __name__)
