"""What the commands do: each calls one public verb and answers; they compute nothing.

To add a command: its function, and an entry in the `COMMANDS` of the module of its subject.
"""

from spatial_pin.cli.commands import (
    at_rest,
    mechanisms,
    motions,
    positions,
    rates_and_forces,
    searching,
    studies,
)
from spatial_pin.cli.options import Command

GROUPS: dict[str, dict[str, Command]] = {
    "mechanisms and their files": mechanisms.COMMANDS,
    "configurations": positions.COMMANDS,
    "motions": motions.COMMANDS,
    "rates and forces": rates_and_forces.COMMANDS,
    "poses at rest": at_rest.COMMANDS,
    "for the eye": motions.PAGES,
    "dimensions": studies.COMMANDS,
    "searches": searching.COMMANDS,
    "accuracy": studies.ACCURACY,
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
