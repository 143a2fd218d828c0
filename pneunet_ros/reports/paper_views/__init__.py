"""The paper's analysis as a view of a fit: steady states, Eqs 9 and 10, sensitivity."""
