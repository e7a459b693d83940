"""Markov chain Monte Carlo: ensembles of walkers sample a posterior until they converge, resumable."""
