"""How likely measured centrelines are: noise, pose and layer depths, marginalised (docs/inference.md)."""
