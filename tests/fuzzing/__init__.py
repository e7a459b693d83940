"""Random damage to every file and text that comes from outside, and what may come of it.

`readers` is the table of readers and valid inputs, `mutations` the damage, `worker` the process in which one
is read, `campaign` what runs many of them. `tests/test_fuzz.py` and `benchmarks/fuzz.py` share all of it.
"""
