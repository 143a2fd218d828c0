"""The command `pneunet`, one file a verb."""
