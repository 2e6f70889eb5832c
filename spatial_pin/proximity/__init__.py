"""How near the bodies of a mechanism come to each other."""
