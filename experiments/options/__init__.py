"""Options of the command line as typed dataclasses; each makes the library's own object from its fields."""
