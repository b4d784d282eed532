"""Closed loops on any rig: what reads samples and gives commands."""
