"""Discovery of laws that no effect of the library explains, in words and as an effect."""
