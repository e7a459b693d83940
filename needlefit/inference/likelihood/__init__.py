"""The likelihood of measured centrelines: noise, pose and layer depths are marginalised
(docs/inference.md).
"""
