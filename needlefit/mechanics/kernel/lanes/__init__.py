"""Many parameter sets of one insertion at once, in the lanes of vector instructions.

A lane is one number of a vector register, and so one parameter set: the compiler turns the innermost loop of
each pass, over LANES sets, into instructions that work on several sets at a time. Who calls whom: `insertion`
(stop to stop) > `newton` (one equilibrium) > `passes` (the loops) > `tables` (the layout of the arrays).
"""
