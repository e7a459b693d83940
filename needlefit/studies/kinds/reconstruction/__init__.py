"""Report what was reconstructed from scans: tables, quality pages, files for 3D Slicer."""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.reconstruction.schema import ReconstructionBatchRecord

KIND = StudyKind("reconstruction", ReconstructionBatchRecord, __name__)
"""What `needlefit reconstruct` writes beside the dataset."""
