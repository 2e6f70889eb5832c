"""What breaks a rule, written out: pytest cuts short what it shows of a long list."""

from collections.abc import Iterable, Mapping


def listed(found: Iterable[object]) -> str:
    """Return all that was found, one a line, with what is said of it where it is a mapping."""
    if isinstance(found, Mapping):
        return "\n".join(f"{name}: {what}" for name, what in found.items())
    return "\n".join(map(str, found))
