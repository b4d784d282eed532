"""Service: commissioning, calibration, moving single actuators, monitoring."""
