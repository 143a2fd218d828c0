"""The page of a survey: all arms of a fleet side by side."""
