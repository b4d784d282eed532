"""The question: candidates, the plant they may be missing in, and the settings of the search."""
