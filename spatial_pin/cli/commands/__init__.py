"""What the commands do: each calls one public verb and answers; they compute nothing.

To add a command: its options, what it does, and its line in the `COMMANDS` of the module of its
subject.
"""

from spatial_pin.cli.commands import (
    accuracy,
    dimensions,
    forces,
    library,
    motions,
    positions,
    rates,
    searching,
    showing,
)
from spatial_pin.cli.options import Command

GROUPS: dict[str, dict[str, Command]] = {
    "mechanisms and their files": library.COMMANDS,
    "configurations": positions.COMMANDS,
    "motions": motions.COMMANDS,
    "rates and forces": {**rates.COMMANDS, **forces.COMMANDS},
    "for the eye": showing.COMMANDS,
    "dimensions": dimensions.COMMANDS,
    "searches": searching.COMMANDS,
    "accuracy": accuracy.COMMANDS,
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
