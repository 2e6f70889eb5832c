"""The Mechanism and its parts: pairs, closures, coordinates, limits, inertias."""
