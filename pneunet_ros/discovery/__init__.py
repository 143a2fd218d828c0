"""From recordings that no effect explains to a law in words, and to an effect that runs."""
