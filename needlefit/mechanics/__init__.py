"""The mechanical model of a needle in tissue: needle, tissue, controls, a readable reference, a C++ kernel,
`simulate`.

It reads no data and no files. docs/model.md states the equations.
"""
