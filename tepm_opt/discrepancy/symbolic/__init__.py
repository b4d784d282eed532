"""The unknown law: where physics that no known effect has acts, what it looks like, and its formula."""
