"""Parameters of a model from measured runs: the least-squares problem, its priors, fits and their uncertainty."""
