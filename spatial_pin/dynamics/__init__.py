"""Forces: forward and inverse dynamics, joint reactions, simulation."""
