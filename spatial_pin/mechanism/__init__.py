"""What a mechanism is, and the files it comes from."""
