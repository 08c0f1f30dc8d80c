"""Declarations of a program's M codes: their names, and the meaning of VA to VH."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .errors import Alarm, ProgramError
from .message_methods import CODE_OF_PARAMETER
from .messages import Params

_LETTERS = "ABCDEFGH"
_NAME_MAX = 40
_UNIT_MAX = 16


@dataclass(frozen=True, kw_only=True)
class Param:
    """Declaration of one parameter, with the numbers that it accepts."""

    name: str | None = None
    """Name, such as ``"force"``."""
    unit: str | None = None
    """Unit, such as ``"kN"``."""
    min: float | None = None
    """Lowest accepted number."""
    max: float | None = None
    """Highest accepted number."""
    whole: bool = False
    """True if only whole numbers are accepted."""
    optional: bool = False
    """True if the parameter may be left out."""

    def takes(self, number: float) -> bool:
        """Return whether the parameter accepts a number; a whole number may have the rounding error of 0.1 * 30."""
        meant = round(number) if self.whole and math.isfinite(number) else number
        return (
            math.isfinite(number)
            and abs(number - meant) <= 1e-9
            and (self.min is None or meant >= self.min)
            and (self.max is None or meant <= self.max)
        )

    def range_text(self) -> str:
        """Return the permitted values, such as ``1 to 20 kN``."""
        unit = f" {self.unit}" if self.unit else ""
        if self.min is not None and self.max is not None:
            text = f"{self.min:g} to {self.max:g}{unit}"
        elif self.min is not None:
            text = f"{self.min:g}{unit} or more"
        elif self.max is not None:
            text = f"{self.max:g}{unit} or less"
        else:
            return ("a whole number" if self.whole else "a number") + (f" in {self.unit}" if self.unit else "")
        return f"a whole number, {text}" if self.whole else text

    def text(self) -> str:
        """Return the name and the range of the parameter."""
        parts = [self.name, self.range_text()]
        return ", ".join(part for part in parts if part) + ("; may be left out" if self.optional else "")

    def to_json(self) -> dict[str, Any]:
        """Return the declaration as the presence message carries it."""
        said = {"name": self.name, "unit": self.unit, "min": self.min, "max": self.max}
        json = {key: value for key, value in said.items() if value is not None}
        return json | {key: True for key in ("whole", "optional") if getattr(self, key)}


@dataclass(frozen=True)
class MCodeDeclaration:
    """The declaration of a handler's M codes."""

    name: str | None
    params: Mapping[str, Param] | None

    def __post_init__(self) -> None:
        """Reject invalid declarations."""
        if self.name is not None and not 1 <= len(self.name) <= _NAME_MAX:
            raise ProgramError(f"name {self.name!r}: write 1 to {_NAME_MAX} characters")
        for letter, param in (self.params or {}).items():
            if len(letter) != 1 or letter not in _LETTERS:
                raise ProgramError(f"{letter!r} is not a parameter; write 'A' to 'H'")
            if param.name is not None and not 1 <= len(param.name) <= _NAME_MAX:
                raise ProgramError(f"V{letter}: name {param.name!r}: write 1 to {_NAME_MAX} characters")
            if param.unit is not None and not 1 <= len(param.unit) <= _UNIT_MAX:
                raise ProgramError(f"V{letter}: unit {param.unit!r}: write 1 to {_UNIT_MAX} characters")
            if param.min is not None and param.max is not None and param.min > param.max:
                raise ProgramError(f"V{letter}: min {param.min:g} is above max {param.max:g}")

    def to_json(self, m: int, cs: int | None) -> dict[str, Any]:
        """Return the declaration as the presence message carries it."""
        json: dict[str, Any] = {"m": m}
        if cs is not None:
            json["cs"] = cs
        if self.name is not None:
            json["name"] = self.name
        if self.params is not None:
            json["params"] = {letter: param.to_json() for letter, param in self.params.items()}
        return json

    def check(self, m: int, params: Params) -> None:
        """Check the parameters of an output.

        Raises:
            Alarm: a parameter does not match the declaration.
        """
        if self.params is None:
            return
        title = f"M{m:02} {self.name}" if self.name else f"M{m:02}"
        for letter in _LETTERS:
            param, value = self.params.get(letter), getattr(params, letter)
            if param is None and value is not None:
                takes = ", ".join(f"V{other} ({one.text()})" for other, one in self.params.items())
                text = f"{title} takes no V{letter}; it takes {takes or 'no parameters'}"
            elif param is not None and value is None and not param.optional:
                text = f"{title} needs V{letter} ({param.text()})"
            elif param is not None and value is not None and not param.takes(value):
                name = f" ({param.name})" if param.name else ""
                unit = f" {param.unit}" if param.unit else ""
                text = f"{title}: V{letter}{name} is {value:g}{unit}; write {param.range_text()}"
            else:
                continue
            raise Alarm(CODE_OF_PARAMETER, text)
