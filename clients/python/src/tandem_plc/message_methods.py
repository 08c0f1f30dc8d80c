"""Methods of the generated message classes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

from .errors import Alarm

if TYPE_CHECKING:
    from .messages import RunEnded

CODE_OF_PARAMETER = 9_997
"""Code of the alarm of a parameter that is missing or out of its range."""


class _AlarmWords(Protocol):
    @property
    def text(self) -> str: ...
    @property
    def remedy(self) -> str | None: ...


class AlarmWordsMethods:
    """Methods of ``AlarmWords``."""

    def to_json(self: _AlarmWords) -> dict[str, str]:
        """Return the declaration as the presence message carries it."""
        return {"text": self.text} if self.remedy is None else {"text": self.text, "remedy": self.remedy}


class _IoDeclaration(Protocol):
    @property
    def kind(self) -> str: ...
    @property
    def min(self) -> float | None: ...
    @property
    def max(self) -> float | None: ...


class IoDeclarationMethods:
    """Methods of ``IoDeclaration``."""

    def wrong(self: _IoDeclaration, value: bool | float) -> str | None:
        """Return why the input or output cannot have this value; ``None`` if it can."""
        if self.kind == "bool":
            return None if isinstance(value, bool) else f"{value!r}: write True or False"
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            return f"{value!r}: write a finite number"
        low = -math.inf if self.min is None else self.min
        high = math.inf if self.max is None else self.max
        return None if low <= value <= high else f"{value:g}: write {low:g} to {high:g}"


class _Run(Protocol):
    @property
    def end(self) -> RunEnded | None: ...


class RunMethods:
    """Methods of ``Run``."""

    @property
    def completed(self: _Run) -> bool:
        """True if all parts are completed."""
        return self.end is not None and self.end.how == "completed"


class ParamsMethods:
    """Methods of ``Params``.

    A function that reads the parameters of an M code is used twice, in its handler and as its check at loading::

        def pocket(params: Params) -> int:
            return params.whole("A", 1, 24, "the pocket")

        @program.on(6, validate=pocket)
        async def change_tool(output: Output) -> None:
            await magazine.turn_to(pocket(output.params))
    """

    def real(self, letter: str, low: float, high: float, what: str) -> float:
        """Read a required parameter within a range, both ends included.

        Args:
            letter: ``"A"`` to ``"H"``.
            low: the lowest accepted value.
            high: the highest accepted value.
            what: name with its unit, such as ``"the clamping force, kN"``: a part of the alarm's text.

        Raises:
            Alarm: the parameter is missing or out of range.
            ValueError: there is no such parameter.
        """
        value = self._value(letter)
        if value is None:
            raise Alarm(CODE_OF_PARAMETER, f"V{letter} is missing: write {what}, {low:g} to {high:g}")
        if not low <= value <= high:
            raise Alarm(CODE_OF_PARAMETER, f"V{letter} is {value:g}: write {what}, {low:g} to {high:g}")
        return value

    def whole(self, letter: str, low: int, high: int, what: str) -> int:
        """Read a whole number, as :meth:`real` does.

        Raises:
            Alarm: the parameter is missing, out of range, or not a whole number.
            ValueError: there is no such parameter.
        """
        value = self.real(letter, low, high, what)
        # NC text calculates in binary fractions: 0.1 * 30 must be accepted as 3
        nearest = round(value)
        if not math.isclose(value, nearest, rel_tol=0.0, abs_tol=1e-9):
            raise Alarm(CODE_OF_PARAMETER, f"V{letter} is {value:g}: write {what}, a whole number from {low} to {high}")
        return nearest

    def _value(self, letter: str) -> float | None:
        if len(letter) != 1 or letter not in "ABCDEFGH":
            raise ValueError(f"{letter!r} is not a parameter; write 'A' to 'H'")
        value: float | None = getattr(self, letter)
        return value
