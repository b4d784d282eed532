"""Data before the search: noise, clocks, measured inputs, devices and beginnings of runs."""
