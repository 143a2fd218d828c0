"""CSV and npz tables, in and out."""
