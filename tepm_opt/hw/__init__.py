"""Rigs: what carries out set points and is measured — simulated, replayed or of hardware. Bytes, limits and time; no CasADi."""
