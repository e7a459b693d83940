"""Walkers that sample a posterior until a rule is met, and can go on."""
