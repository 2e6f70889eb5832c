"""The compiled kernel: a mechanism as flat arrays, and the C functions that work on them."""
