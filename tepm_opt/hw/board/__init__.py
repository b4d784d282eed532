"""The line to the control board: protocol, ports, conversation, calibration, the rig that stands on them."""
