"""Mechanisms made in code: a Pinocchio model and closures between its frames."""
