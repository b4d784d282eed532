"""Tables of other laboratories, read by a map file into runs: readers, units, resampling, and refusals that say which entry mends them."""
