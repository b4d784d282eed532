"""Self-contained HTML pages of what jobs found, all on one template: `template` and `charts` are what they share."""
