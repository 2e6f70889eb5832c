"""Faults that do not stop the reading of a file; one warning names them all."""

from __future__ import annotations

NAMED_FAULTS = 3  # of one kind in a warning: enough to see what they have in common


class Faults:
    """What is wrong in a file that is read all the same, kind by kind."""

    def __init__(self) -> None:
        self._named: dict[str, list[str]] = {}

    def note(self, kind: str, what: str = "") -> None:
        """Note a fault.

        Args:
            kind: the fault and its treatment.
            what: the link, joint or file that has it; "" where `kind` says it.
        """
        named = self._named.setdefault(kind, [])
        if what and what not in named:
            named.append(what)

    def notices(self, most: int | None = None) -> tuple[str, ...]:
        """Return a sentence for each kind, with all its faults or the first few."""
        sentences = []
        for kind, names in self._named.items():
            named = ", ".join(names[:most])
            rest = len(names) - len(names[:most])
            more = f" and {rest} more" if rest else ""
            sentences.append(f"{named}{more}: {kind}" if names else kind)
        return tuple(sentences)

    def summary(self) -> str:
        """Return one line for a warning, "" where nothing is wrong."""
        notices = self.notices(NAMED_FAULTS)
        if len(notices) < 2:
            return "".join(notices)
        return "; ".join(f"({k}) {notice}" for k, notice in enumerate(notices, start=1))
