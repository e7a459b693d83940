"""Sample a posterior by Markov chain Monte Carlo: ensembles of walkers, until they converge; resumable."""
