"""Alarms that a program declares: text, remedy, languages."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .errors import CODE_MAX, TEXT_MAX, Alarm, ProgramError
from .messages import AlarmWords

LANGUAGES_MAX = 8
ALARMS_MAX = 256
"""Maximum number of alarms that one program may declare."""

_TAG = re.compile(r"[A-Za-z0-9-]{2,16}")


@dataclass(frozen=True)
class UserAlarm:
    """An alarm with text, remedy and languages, for a constant.

    ::

        NO_AIR = UserAlarm(
            12,
            "the air pressure is low",
            remedy="Open the main valve, and look at the pressure gauge.",
            languages={"de": AlarmWords("der Luftdruck ist zu niedrig", "Hauptventil öffnen, Druckanzeige prüfen.")},
        )
        program.alarms(NO_AIR)
        raise NO_AIR.alarm("2.1 bar")

    Raises:
        ProgramError: the code is not 0 to 9999, a text is empty or too long, or there are more than 8 languages.
    """

    code: int
    """0 to 9999; the machine shows the number 10000 + code."""
    text: str
    """Description of the fault for the operator."""
    remedy: str | None = field(default=None, kw_only=True)
    """The remedy."""
    languages: Mapping[str, AlarmWords] = field(default_factory=dict, kw_only=True)
    """Text and remedy in other languages, by language tag, such as ``de`` or ``pt-BR``."""

    def __post_init__(self) -> None:
        """Reject invalid values."""
        if not 0 <= self.code <= CODE_MAX:
            raise ProgramError(f"alarm {self.code}: write 0 to {CODE_MAX}")
        if len(self.languages) > LANGUAGES_MAX:
            raise ProgramError(f"alarm {self.code}: {len(self.languages)} languages: write up to {LANGUAGES_MAX}")
        for tag in self.languages:
            if _TAG.fullmatch(tag) is None:
                raise ProgramError(f"alarm {self.code}: language {tag!r}: write a tag such as 'de' or 'pt-BR'")
        for words in (AlarmWords(self.text, self.remedy), *self.languages.values()):
            if any(text is not None and not 1 <= len(text) <= TEXT_MAX for text in (words.text, words.remedy)):
                raise ProgramError(f"alarm {self.code}: text and remedy: write 1 to {TEXT_MAX} characters")

    def alarm(self, detail: object = None) -> Alarm:
        """Make the alarm to raise, with details appended to its text."""
        return Alarm(self.code, self.text if detail is None else f"{self.text}: {detail}")

    def to_json(self) -> dict[str, Any]:
        """Return the declaration as the presence message carries it."""
        json: dict[str, Any] = {"code": self.code, **AlarmWords(self.text, self.remedy).to_json()}
        if self.languages:
            json["languages"] = {tag: words.to_json() for tag, words in self.languages.items()}
        return json
