"""YAML, npz and JSON files, read and written whole."""
