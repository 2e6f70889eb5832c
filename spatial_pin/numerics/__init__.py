"""Mathematics without mechanisms: factorisations, interpolation, Chebyshev polynomials."""
