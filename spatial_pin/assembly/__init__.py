"""From a guess to a closed State."""
