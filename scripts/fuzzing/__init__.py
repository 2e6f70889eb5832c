"""Random mechanisms and mutated files, judged by computations that share nothing with the library.

`generate` invents mechanisms that close by construction, `files` writes them down, `judge` works
out in extended precision what is true of them, `kinematic_checks` and `force_checks` compare the
library's answers with that, `records` tells how each comparison ended. `mutate` damages files.
`drawing` invents mechanisms with redundant equations at a pose where they close, `drawn_files`
writes them with a few digits, `drawn_checks` compares what such files answer with the exact ones.
"""
