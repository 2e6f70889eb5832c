"""Motion in time under forces."""
