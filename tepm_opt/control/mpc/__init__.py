"""Model predictive control: prediction, terminal cost, the quadratic program in the tensions, and the same step in C."""
