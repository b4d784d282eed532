"""Plants in the form that the search asks for: the network, equations, CasADi functions, any callable."""
