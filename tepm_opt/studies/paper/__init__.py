"""The experiments of Kang et al. (2017) on the simulated rigs and on the model, against the published numbers."""
