"""The next run: information, and the separation of the hypotheses that are left."""
