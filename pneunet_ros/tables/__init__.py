"""Reading and writing CSV and npz tables."""
