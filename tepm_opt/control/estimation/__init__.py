"""The arm's motion from tracked points: Kalman filter, Dahl friction, lengths."""
