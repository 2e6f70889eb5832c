"""SDFormat, read with standard XML: one model, or a world with one, as a joint graph."""
