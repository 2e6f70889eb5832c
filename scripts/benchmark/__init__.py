"""What `scripts/bench.py` measures, and how: tasks, tools, workers, report.

To add a row: a `Case` in the `CASES` of the module of its tool (see `case`). To add a tool: a
module with `CASES` and an entry in `tools.TOOLS`. To add a task: an entry in `case.TASKS`.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))  # published_*
