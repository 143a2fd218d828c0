"""The command `pneunet`, with one file per verb."""
