"""What dimensions change: sensitivity, tolerance, and many samples closed together."""
