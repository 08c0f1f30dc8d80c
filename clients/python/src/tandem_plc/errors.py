"""Errors of the package."""

from __future__ import annotations

USER_ALARM_BASE = 10_000
"""First alarm number of sequence programs: the number of an alarm is this base plus the code."""

CODE_MAX = 9_999
"""Highest code of a sequence program's alarm."""

TEXT_MAX = 1_000
"""Maximum number of characters of an alarm's text; a longer text is cut."""

CODE_OF_ERROR = 9_999
"""Code of the alarm that a :class:`TandemError` in a handler becomes."""

CODE_OF_EXCEPTION = 9_998
"""Code of the alarm that any other exception in a handler becomes."""


class Alarm(Exception):
    """An alarm of a sequence program: raised in a handler, it stops the NC program.

    The machine shows number ``10000 + code`` and the text, unchanged.

    Raises:
        ValueError: the code is not 0 to 9999, or the text is empty.
    """

    def __init__(self, code: int, text: str) -> None:
        if not 0 <= code <= CODE_MAX:
            raise ValueError(f"alarm code {code}: write 0 to {CODE_MAX}")
        if not text:
            raise ValueError("an alarm needs a text: describe the fault for the operator")
        super().__init__(code, text)
        self.code = code
        self.text = text[:TEXT_MAX]

    @property
    def number(self) -> int:
        """Number that the machine shows: 10000 + code."""
        return USER_ALARM_BASE + self.code

    def __str__(self) -> str:
        return f"alarm {self.number}: {self.text}"


class TandemError(Exception):
    """Base of all errors between a program and a machine."""


class AddressError(TandemError):
    """The address is not a valid address of a machine."""


class ProgramError(TandemError):
    """A sequence program has a mistake, such as two handlers for one M code."""


class TakenOver(TandemError):
    """Another process with this handler id serves the machine: this process has ended, or was refused."""


class ConnectError(TandemError):
    """The machine was not found in time, or the broker refuses this client for good."""


class NotConnected(TandemError):
    """There is no connection; nothing was sent and nothing has changed."""


class RequestRefused(TandemError):
    """The machine has refused a request; nothing has changed."""

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code
        """Machine-readable reason, such as ``not_allowed``, ``start_locked`` or ``invalid``."""
        self.text = text
        """The event, its cause, and the remedy."""


class CommandFailed(TandemError):
    """A command was accepted, but its effect was prevented."""

    def __init__(self, verb: str, code: str, text: str, moved: dict[str, float] | None = None) -> None:
        super().__init__(f"{verb} failed: {text}")
        self.verb = verb
        self.code = code
        """Machine-readable reason."""
        self.text = text
        """The reason why the command had no effect."""
        self.moved = moved or {}
        """Distance covered by ``jog``, ``mdi`` or ``home``, by axis letter, mm or degrees."""


class NoAnswer(TandemError):
    """The machine did not answer within the time limit, so the effect of the request is unknown.

    A command can be repeated safely with ``command_id=error.command_id``: within 10 minutes and one boot the machine
    repeats its answer and does not execute it twice.
    """

    def __init__(self, what: str, timeout_s: float, command_id: str | None) -> None:
        super().__init__(f"{what}: no answer within {timeout_s:g} s; its effect is unknown")
        self.command_id = command_id
        """Id of the command; ``None`` if the request was not a command."""


class OutputEnded(TandemError):
    """The output no longer belongs to this handler: it was cancelled, reset by hand, or belongs to another boot."""
