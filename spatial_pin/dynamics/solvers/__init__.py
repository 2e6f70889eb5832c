"""Accelerations and reactions: the equations of motion at one State, and their solvers."""
