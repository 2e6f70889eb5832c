"""How free a mechanism is, and the modes in which it can be assembled."""
