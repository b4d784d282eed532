"""A bench without hardware, in real time: a board of messages, which is not the firmware, the simulated arm, and a tracker's server."""
