"""From one equilibrium to another: continuation, descent of the energy, neighbors."""
