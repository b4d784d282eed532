"""Files for other programs: C, CasADi's function files, MuJoCo's models, logs."""
