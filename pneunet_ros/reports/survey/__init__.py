"""The page of a survey: comparison of all arms of a fleet."""
