"""Mechanisms as differentiable functions, and in a control loop."""
