"""Following paths of closed configurations, branch points and turning points included."""
