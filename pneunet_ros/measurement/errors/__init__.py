"""What is not known of a reading and of the model, and what follows from it."""
