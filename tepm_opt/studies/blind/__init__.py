"""Blind trials: data sets of machines that are not the model, what is hidden in them, and how often a verdict on them is right."""
