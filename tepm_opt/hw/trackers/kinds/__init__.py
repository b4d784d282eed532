"""Built-in kinds of trackers, one file each."""
