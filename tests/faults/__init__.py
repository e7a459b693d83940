"""Faults at every step by which a command writes: the disk is full, the disk fails, the process is killed.

`injection` counts the steps below a folder and does the harm at the n-th, `server` runs commands in forks of
a warm process, `commands` are the commands with small inputs, `outcome` says what must hold afterwards.
`tests/test_fuzz.py` takes some of the steps.
"""
