"""URDF: what it must be, its elements and shapes, and the open tree as a Pinocchio model."""
