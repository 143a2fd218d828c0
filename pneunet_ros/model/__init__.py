"""Model of an actuator: curvature, moment law, arm, equilibrium, inverse problem."""
