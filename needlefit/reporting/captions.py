"""What stands under each figure."""

BOXPLOT = (
    "Errors on held-out insertions. Boxes span the quartiles and whiskers the 5th to the 95th percentile, of "
    "the in-plane errors of all points and of the tip errors; tips of fewer than five insertions are shown "
    "as points alone. Filled diamonds are our means over insertions, open ones the paper’s on its own "
    "needles, dashes the noise floor’s."
)
OVERLAYS = (
    "Measured needles (dots) and what the model makes of them (lines), one panel per insertion, all in the "
    "same axes, depth and deflection to the same scale. Bands: where 50 and 95 % of measurements of a "
    "held-out needle were foretold to lie. Deflection is positive toward the bevel. Above each panel stand "
    "its errors."
)
RESIDUALS = (
    "What needles drawn to scale hide: deflection less that of the fitted needle at the same depth, positive "
    "toward the bevel; stretched freely, for it is no geometry. Bands as above: they are of draws of the "
    "posterior, with the errors of measurement, along the layers that each draw would meet, and need not lie "
    "about the fit. Curves that leave a panel lie farther off; the straight line is left out."
)
WATERFALL = (
    "Left: how far each start of a search ended above its best, best first, in units of what still counts as "
    "practically as good (dashed): 0.1 of the log posterior, or 1 % of the metric objective and at least "
    "0.002 mm. Right: where the starts left each free parameter between its bounds (written at the ends; μ "
    "and b in logarithms). Filled dots spread along the axis mean that the data do not determine it."
)
CORNER = (
    "The posterior, one parameter and one pair at a time; moduli and b in logarithms. Draws (dots, and their "
    "histograms), the fit and the paper’s set; dotted, the bounds and what the flat prior between them would "
    "have the histograms be."
)
FORETOLD = (
    "Whether held-out needles came out as foretold. Left: the share of needles whose level is at most so "
    "high; a level is the probability foretold of a tip less far toward the bevel, or of a shape nearer at "
    "its worst point. Right predictions stay in the grey band throughout, but for 5 %. Right: what share of "
    "needles the 50 and 95 % intervals held, with Wilson’s interval of so few trials; a needle is one trial, "
    "and repeats in one specimen are one where there are specimens enough."
)
RANKS = (
    "Where truths stood among draws of their posteriors: the ECDF of the ranks of each quantity, less that "
    "of uniform ones, on the band in which chance keeps it. First above and then below, posteriors are too "
    "narrow; the other way round, too wide."
)
CONVERGENCE = (
    "Manufactured solutions: largest error in the tissue under refinement, per case. Dashed: the orders that "
    "theory promises. “At the nodes”: the largest of all cases there alone, where the slope superconverges."
)
PROFILES = (
    "Profile likelihoods: how the best fit worsens as one parameter is held away from it and all others are "
    "fitted again (solid; dots were computed). The 95 % interval is shaded: where the curve stays under the "
    "dashed line up to a bound, the data do not end it. Dashed: what the information at the optimum alone "
    "would say. Panels end at the bounds, or well above the line."
)
RIVALS = (
    "Mean in-plane error of the fitted model and of what it has to beat, on the same held-out points. The "
    "further left, the better; at the dashed noise floor an error is that of the measurement."
)
