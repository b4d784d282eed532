"""The documentation as a site: `python -m docs.site OUT`. Pages are those of docs/ and of the root, and what the program says itself."""
