"""Compare which model predicts best: tissue laws and empirical curves, on needles that they were not fitted
to.

Every candidate has a posterior, by one likelihood, of its own parameters and of one factor of the noise, so
that what it misses is paid for as noise. How probable it makes a needle y that was held out of the data D,

    log p(y | D) = log of the mean, over the posterior of D, of p(y | theta) = log Z(D, y) - log Z(D),

y being all its points together, is the ratio of two evidences (`inference.sampling.importance`), each by
importance about its own peaks: errors of points, pose and depths as the likelihood has them, and the layers
that the fit to D meets on the planned path of y, the same for all theta.

Differences of log p between two candidates are taken needle by needle, summed over repeats in one specimen
where there are enough specimens, and their sum over G groups has the standard error sqrt(G) sd (A. Vehtari,
A. Gelman, J. Gabry, Stat. Comput. 27 (2017) 1413, section 5; too small where G is: T. Sivula, M. Magnusson,
A. A. Matamoros, A. Vehtari, arXiv 2008.10296). What the draws behind both leave open is added to it in
squares. A difference of less than two standard errors is a tie.
"""

from needlefit.studies.kind import StudyKind
from needlefit.studies.kinds.comparison.schema import ComparisonRecord

KIND = StudyKind("comparison", ComparisonRecord, __name__)
