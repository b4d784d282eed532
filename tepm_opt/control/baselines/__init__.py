"""Controllers to compare with: PID on lengths, the modes of the paper, LQG. Every module here that has a kind adds a controller."""
