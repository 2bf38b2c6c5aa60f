"""Pictures from numbers: matplotlib is imported here only, and nothing of the studies or the command line."""
