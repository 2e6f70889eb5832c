"""A reduced mechanism in the making: links replaced by relations, equations left out."""
