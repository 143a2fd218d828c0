"""Causes outside the library, hidden by the virtual lab, for trials of discovery."""
