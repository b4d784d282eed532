"""Self-contained HTML pages of what jobs found: `pages` of the main job and of a verdict, `paper` of the experiments."""
