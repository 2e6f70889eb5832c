"""First to third derivatives at a State."""
