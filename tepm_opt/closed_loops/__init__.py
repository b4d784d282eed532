"""Closed loops: a reference from rest, a controller on a rig, what came of it, and what is left of it in a folder."""
