"""What other programs read: C, CasADi's function files, MuJoCo's models, logs."""
