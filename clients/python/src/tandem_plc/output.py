"""One output, as its handler uses it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .errors import NoAnswer, NotConnected, OutputEnded, RequestRefused
from .messages import CancelReason, Params, PendingOutput

if TYPE_CHECKING:
    from .connection import Connection

_RETRY_S = 0.5

QUESTION_MAX = 200
CHOICES_MAX = 8
CHOICE_MAX = 40
PROGRESS_MAX = 200

# Largest number of bytes of a checkpoint as JSON.
CHECKPOINT_MAX = 4096


class Output:
    """An auxiliary function output: an M code with its parameters, on which a handler works.

    If the output is cancelled, the task of the handler is cancelled: ``asyncio.CancelledError`` is raised at its
    current await, and :attr:`cancel_reason` is the cause. Put clean-up work into ``finally``.
    """

    def __init__(
        self,
        connection: Connection,
        identity: dict[str, Any],
        boot_id: str,
        cs: int,
        notice: PendingOutput,
        *,
        redelivered: bool,
    ) -> None:
        self._connection = connection
        self._identity = identity
        self._notice = notice
        self._turn = asyncio.Lock()
        self._progress: dict[str, Any] | None = None
        self._checkpoint: dict[str, Any] | None = None
        self.boot_id = boot_id
        """The boot of the runtime that issued the output."""
        self.cs = cs
        """Coordinate system that issued the output."""
        self.redelivered = redelivered
        """True if the work may already have begun and the redelivery is ``verify``: check the machine first."""
        self.last_checkpoint: Any = notice.checkpoint
        """The last :meth:`checkpoint` of a previous handler of this output; ``None`` if no checkpoint was stored."""
        self.cancelled = False
        """True once the output is cancelled."""
        self.cancel_reason: CancelReason | None = None
        """Reason of the cancellation; ``None`` without a cancellation, or if the reason was lost with a connection."""

    @property
    def m(self) -> int:
        """M number, 0 to 191."""
        return self._notice.m

    @property
    def id(self) -> str:
        """Identifies this output permanently, also across restarts: the key of work that must be done only once."""
        return self._notice.id

    @property
    def seq(self) -> int:
        """Sequence number: identifies this output within boot and coordinate system."""
        return self._notice.seq

    @property
    def params(self) -> Params:
        """VA to VH."""
        return self._notice.params

    @property
    def a(self) -> float | None:
        """VA as written; ``None`` if omitted."""
        return self._notice.params.A

    @property
    def b(self) -> float | None:
        """VB."""
        return self._notice.params.B

    @property
    def c(self) -> float | None:
        """VC."""
        return self._notice.params.C

    @property
    def d(self) -> float | None:
        """VD."""
        return self._notice.params.D

    @property
    def e(self) -> float | None:
        """VE."""
        return self._notice.params.E

    @property
    def f(self) -> float | None:
        """VF."""
        return self._notice.params.F

    @property
    def g(self) -> float | None:
        """VG."""
        return self._notice.params.G

    @property
    def h(self) -> float | None:
        """VH."""
        return self._notice.params.H

    @property
    def program(self) -> int:
        """Number of the NC program that issued the output."""
        return self._notice.program

    @property
    def line(self) -> int:
        """Line of the source file, from 1."""
        return self._notice.line

    @property
    def run_id(self) -> str:
        """Id of the program run that issued the output."""
        return self._notice.run_id

    def __repr__(self) -> str:
        return f"<Output M{self.m} seq {self.seq} of coordinate system {self.cs}>"

    def _path(self, what: str) -> str:
        return f"cs/{self.cs}/m_code/{self.m}/{what}"

    def _named(self) -> dict[str, Any]:
        return {"boot_id": self.boot_id, "seq": self.seq, **self._identity}

    def progress(self, text: str, percent: float | None = None) -> None:
        """Report the current step of the handler; panels show it while the program waits.

        The report is sent again after a loss of the connection. No effect if this handler no longer owns the output.

        Args:
            text: at most 200 characters; a longer text is cut.
            percent: 0 to 100.
        """
        report: dict[str, Any] = {**self._named(), "text": text[:PROGRESS_MAX]}
        if percent is not None:
            report["percent"] = min(max(float(percent), 0.0), 100.0)
        self._progress = report
        self._post_report("progress", report)

    def checkpoint(self, value: Any) -> None:
        """Store a checkpoint that records the progress of the work; it replaces the previous checkpoint.

        If this handler is lost, the next handler finds the checkpoint in :attr:`last_checkpoint`. The machine keeps it
        until the output ends. It is sent again after a loss of the connection. No effect if this handler no longer owns
        the output.

        Args:
            value: at most 4096 bytes as JSON; ``None`` removes the checkpoint.

        Raises:
            ValueError: the checkpoint is too long.
            TypeError: the checkpoint cannot be written as JSON.
        """
        size = len(json.dumps(value, separators=(",", ":"), ensure_ascii=False).encode())
        if size > CHECKPOINT_MAX:
            raise ValueError(f"a checkpoint has at most {CHECKPOINT_MAX} bytes as JSON, but this checkpoint has {size}")
        self._checkpoint = {**self._named(), "checkpoint": value}
        self._post_report("checkpoint", self._checkpoint)

    def _post_report(self, what: str, report: dict[str, Any] | None) -> None:
        if report is not None and not self.cancelled:
            self._connection.post(self._path(what), report)

    def _post_reports_again(self) -> None:
        self._post_report("progress", self._progress)
        self._post_report("checkpoint", self._checkpoint)

    async def ask(self, text: str, choices: Sequence[str]) -> str:
        """Ask the operator, and wait for one of the choices.

        The question is shown with the output and ends with it. Several questions are asked one after the other. If the
        caller is cancelled, the question is withdrawn.

        Args:
            text: 1 to 200 characters.
            choices: 1 to 8 different texts of 1 to 40 characters.

        Raises:
            ValueError: text or choices are out of range.
            OutputEnded: the output no longer belongs to this handler.
        """
        _check_question(text, choices)
        async with self._turn:
            question = {**self._named(), "question_id": f"question-{secrets.token_hex(6)}"}
            try:
                return await self._until_answered({**question, "text": text, "choices": list(choices)})
            except (asyncio.CancelledError, RequestRefused):
                self._connection.post(self._path("ask"), {**question, "choices": []})
                raise

    async def _until_answered(self, question: dict[str, Any]) -> str:
        pendings = self._connection.hub.follow(f"cs/{self.cs}/m_code/pending")
        path, timeout_s = self._path("ask"), _RETRY_S * 4
        clock = asyncio.get_running_loop().time
        is_shown, ask_at = False, clock()
        try:
            next_pending = asyncio.ensure_future(anext(pendings))
            while True:
                # repeats the question until it is shown: the claim may have been lost with the connection
                if not is_shown and clock() >= ask_at:
                    with contextlib.suppress(NoAnswer, NotConnected):
                        await self._connection.request(path, question, timeout_s=timeout_s)
                    ask_at = clock() + _RETRY_S
                timeout = None if is_shown else max(ask_at - clock(), 0)
                done, _ = await asyncio.wait({next_pending}, timeout=timeout)
                if not done:
                    continue
                pending = next_pending.result()
                next_pending = asyncio.ensure_future(anext(pendings))
                if pending.boot_id != self.boot_id:
                    continue
                shown = next((output for output in pending.outputs if output.seq == self.seq), None)
                if shown is None:
                    raise OutputEnded(f"M{self.m} ended before the question was answered")
                asked = shown.question
                is_shown = asked is not None and asked.id == question["question_id"]
                if is_shown and asked is not None and asked.answer is not None:
                    answer: str = asked.answer
                    return answer
        finally:
            next_pending.cancel()


def _check_question(text: str, choices: Sequence[str]) -> None:
    if isinstance(choices, str):
        raise TypeError(f"choices are texts, such as [{choices!r}]")
    if not 1 <= len(text) <= QUESTION_MAX:
        raise ValueError(f"a question has 1 to {QUESTION_MAX} characters")
    if not 1 <= len(choices) <= CHOICES_MAX:
        raise ValueError(f"a question has 1 to {CHOICES_MAX} choices")
    if any(not 1 <= len(choice) <= CHOICE_MAX for choice in choices):
        raise ValueError(f"a choice has 1 to {CHOICE_MAX} characters")
    if len(set(choices)) != len(choices):
        raise ValueError("a choice occurs twice")
