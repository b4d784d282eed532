"""The worth of a hypothesis: credibility, constancy, locations of residuals, a black box as a bound."""
