"""References of the tip: in time, by path, as quickly as can be, and better from round to round."""
