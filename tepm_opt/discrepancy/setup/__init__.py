"""Set-up errors: exchanged hoses, tendons and markers, turned frames, wrong units, told before any physics is looked for."""
