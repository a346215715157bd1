"""What goes wrong in a way that the user can mend: one readable line, and an exit status."""

from __future__ import annotations


class MarkerbridgeError(Exception):
    """Base of all errors that end a command with one line; it names what to do."""

    exit_status = 1


class UsageError(MarkerbridgeError, ValueError):
    """The command line asks for something that cannot be meant."""

    exit_status = 2
