"""The next recording: what is still possible, and which experiment tells it apart."""
