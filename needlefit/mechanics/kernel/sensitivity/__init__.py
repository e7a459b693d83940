"""Exact derivatives: `insertion` > `tangent`, `adjoint` > `derivatives`, `perturbation`; `movement` in C."""
