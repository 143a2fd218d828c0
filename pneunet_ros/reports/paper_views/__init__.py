"""The paper's analysis applied to a fit: steady states, Eqs 9 and 10, sensitivity."""
