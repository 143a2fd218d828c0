"""Mass and damping of an arm, from recordings of its motion."""
