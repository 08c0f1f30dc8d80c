"""Parameters VA to VH of an M code."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .errors import Alarm

CODE_OF_PARAMETER = 9_997
"""Code of the alarm of a parameter that is missing or out of its range."""


@dataclass(frozen=True, kw_only=True)
class Params:
    """VA to VH as the program wrote them; ``None`` if omitted.

    A function that reads the parameters of an M code is used twice, in its handler and as its check at loading::

        def pocket(params: Params) -> int:
            return params.whole("A", 1, 24, "the pocket")

        @program.on(6, validate=pocket)
        async def change_tool(output: Output) -> None:
            await magazine.turn_to(pocket(output.params))
    """

    A: float | None = None
    B: float | None = None
    C: float | None = None
    D: float | None = None
    E: float | None = None
    F: float | None = None
    G: float | None = None
    H: float | None = None

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
