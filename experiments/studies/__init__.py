"""Studies: a task and its settings in, numbers and pictures out. They know nothing of the command line."""
