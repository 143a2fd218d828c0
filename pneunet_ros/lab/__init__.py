"""The virtual lab: camera images of an arm with exact truth, by code of its own."""
