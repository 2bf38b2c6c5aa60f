"""What each subcommand does, in terms of the library; one file per subject."""
