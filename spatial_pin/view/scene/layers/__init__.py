"""What can be drawn of a mechanism, one layer a file."""
