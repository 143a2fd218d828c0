"""Methods to reach an equilibrium: continuation, energy descent, neighbors."""
