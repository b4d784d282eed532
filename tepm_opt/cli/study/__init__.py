"""`tepm study`: the project's own studies."""
