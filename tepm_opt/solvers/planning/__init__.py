"""Paths of the tip, and the fastest, or the gentlest, motion from rest to rest, as set points."""
