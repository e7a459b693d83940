"""Which model foretells best: tissue laws and empirical curves, each on needles that it was not fitted to.

Every candidate has a posterior, by one likelihood, of its own parameters and of one factor of the noise, so
that what it misses is paid for as noise. A needle held out is foretold by the mean of its density over draws,

    log p(y) = log mean_b p(y | theta_b),

y being all its points together, with the errors of points, pose and depths as the likelihood has them, and
the layers that each draw's own needle meets on its planned path. Differences of log p between two candidates
are taken needle by needle, summed over repeats in one specimen where there are enough specimens, and their
sum over G groups has the standard error sqrt(G) sd (A. Vehtari, A. Gelman, J. Gabry, Stat. Comput. 27 (2017)
1413, section 5; too small where G is: T. Sivula, M. Magnusson, A. A. Matamoros, A. Vehtari, arXiv
2008.10296). A difference of less than two standard errors is a tie.
"""
