"""An actuator and its statics: curvature, moment law, arm, equilibrium, inverse problem."""
