"""Obstacles: their geometry, constraints that keep the arm away from them, and paths that are led round."""
