"""Random mechanisms and mutated files, judged by computations that share nothing with the library.

`generate` invents mechanisms that close by construction, `files` writes them down, `judge` works
out in extended precision what is true of them, `kinematic_checks` and `force_checks` compare the
library's answers with that, `records` tells how each comparison ended. `mutate` damages files.
"""
