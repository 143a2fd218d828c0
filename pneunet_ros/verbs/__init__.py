"""The verbs of `pneunet`: a new verb is one file here and one line in the table of `cli`."""
