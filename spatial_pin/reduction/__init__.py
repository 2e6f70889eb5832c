"""The smallest mechanism that yields the same outputs."""
