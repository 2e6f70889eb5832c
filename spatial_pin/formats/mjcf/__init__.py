"""MJCF, MuJoCo's models, read through the `mujoco` package, and written without it."""
