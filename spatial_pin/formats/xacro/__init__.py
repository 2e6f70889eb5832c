"""xacro, which is parametric URDF: expanded without trusting it."""
