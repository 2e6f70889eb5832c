"""URDF: its validation, its elements and shapes, and the open tree as a Pinocchio model."""
