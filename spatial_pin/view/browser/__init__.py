"""Pictures and films, taken by a browser without a window."""
