"""Reading and writing YAML, npz and JSON files."""
