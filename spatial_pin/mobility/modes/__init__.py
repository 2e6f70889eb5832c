"""Assembly modes: all closed configurations for given driver values."""
