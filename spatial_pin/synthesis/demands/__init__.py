"""What a mechanism should be like, one kind of demand a class."""
