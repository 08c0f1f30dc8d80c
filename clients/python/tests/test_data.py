"""Tests without a machine: addresses, parameters, mistakes, and invalid data."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

import pytest

from tandem_plc import AddressError, Alarm, Output, Params, ProgramError, SequenceProgram, messages
from tandem_plc.address import Address
from tandem_plc.connection import Connection
from tandem_plc.decode import DecodeError, decode
from tandem_plc.hub import BACKLOG_MAX, TOPICS_MAX, Hub
from tandem_plc.topics import FILTERS, form_of
from tandem_plc.within import within


def test_an_address_names_brokers_user_prefix_and_machine() -> None:
    address = Address.parse("mqtts://anna:p%40ss@a,b:1884,[::1]/hall/3/mill-1")
    assert address.nodes == (("a", 8883), ("b", 1884), ("::1", 8883))
    assert (address.user, address.password, address.root) == ("anna", "p@ss", "hall/3/tandem/v1/mill-1")
    assert Address.parse("127.0.0.1/m").nodes == (("127.0.0.1", 1883),)
    assert "p@ss" not in repr(address)
    assert "p%40ss" not in address.shown


@pytest.mark.parametrize(
    "wrong",
    [
        "mqtt://u:secret@host:1883",
        "mqtt://u:secret@:1883/m",
        "mqtt://u:secret@h:x/m",
        "mqtt://u:secret@h/a/#/m",
        "mqtt://u:secret@h//m",
        "mqtt://u:secret@[::1/m",
        "mqtt://u:secret/@h/m",
        "mqtt://h,mqtt://u:secret@i/m",
        "http://u:secret@h/m",
        f"mqtt://u:secret@{'a,' * 16}a/m",
    ],
)
def test_a_wrong_address_is_refused_without_the_password(wrong: str) -> None:
    with pytest.raises(AddressError) as refused:
        Address.parse(wrong)
    assert "secret" not in str(refused.value)


def test_parameters_have_ranges_and_whole_numbers() -> None:
    params = Params(A=24, B=2.5, C=0.1 * 30)
    assert (params.whole("A", 1, 24, "the pocket"), params.real("B", 0, 2.5, "the force, kN")) == (24, 2.5)
    assert params.whole("C", 1, 3, "parts") == 3
    mistakes: list[tuple[Callable[[], object], str]] = [
        (lambda: params.whole("A", 1, 23, "the pocket"), "VA is 24: write the pocket, 1 to 23"),
        (lambda: params.whole("B", 1, 3, "the side"), "VB is 2.5: write the side, a whole number from 1 to 3"),
        (lambda: params.real("H", 0, 1, "the way"), "VH is missing: write the way, 0 to 1"),
    ]
    for wrong, text in mistakes:
        with pytest.raises(Alarm) as alarm:
            wrong()
        assert alarm.value.text == text
    with pytest.raises(ValueError, match="write 'A' to 'H'"):
        params.real("J", 0, 1, "x")


def test_an_alarm_has_number_10000_plus_code() -> None:
    assert (Alarm(17, "x").number, len(Alarm(0, "é" * 2_000).text)) == (10_017, 1_000)
    for code, text in [(-1, "x"), (10_000, "x"), (1, "")]:
        with pytest.raises(ValueError, match="alarm"):
            Alarm(code, text)


async def handler(_output: Output) -> None: ...


def test_mistakes_of_a_program_are_said_in_a_sentence() -> None:
    program = SequenceProgram("p")
    program.on(6, range(20, 22))(handler)
    program.on(6, cs=2)(handler)
    mistakes: list[tuple[Callable[[], object], str]] = [
        (lambda: program.on(21)(handler), "M21 has two handlers"),
        (lambda: program.on(30)(handler), "M30: the runtime handles this M code itself"),
        (lambda: program.on(192)(handler), "M192: M codes are 0 to 191"),
        (lambda: program.on(range(0))(handler), "no M code is named"),
        (lambda: program.on(8)(lambda output: None), "is not async: write `async def"),  # type: ignore[type-var]
        (lambda: SequenceProgram("a/b"), "write 1 to 64 characters"),
    ]
    for wrong, text in mistakes:
        with pytest.raises(ProgramError, match=text.replace("(", r"\(").replace("+", r"\+")):
            wrong()

    async def three(_output: Output, _plc: Any, _more: int) -> None: ...

    with pytest.raises(ProgramError, match="takes 3 arguments: write `async def three"):
        program.on(9)(three)  # type: ignore[type-var]
    program.validate(9)(lambda _params: None)
    with pytest.raises(ProgramError, match="M9 is validated and has no handler"):
        asyncio.run(program.run("mqtt://127.0.0.1:9/none"))


CANCEL = {"v": 1, "boot_id": "b", "ts": "t", "seq": 7, "reason": "stop", "later": ["a", "field"]}


def test_message_is_decoded_and_its_unknown_members_and_words_are_accepted() -> None:
    cancel = messages.Cancel(boot_id="b", ts="t", seq=7, reason=messages.CancelReason.STOP)
    assert decode(messages.Cancel, CANCEL) == cancel
    values = {"from": 3, "kind": "P", "values": [1.5, "NaN"]}
    assert decode(messages.VariableValues, values).from_ == 3
    ended = {"at": "t", "how": "a later word", "place": None, "text": ""}
    assert str(decode(messages.RunEnded, ended).how) == "a later word"
    motor = {"number": 1, "kind": "linear", "max_velocity": 1.0}
    assert decode(messages.MotorInfo, {**motor, "soft_limits": [-1.0, 2.0]}).soft_limits == (-1.0, 2.0)
    with pytest.raises(DecodeError, match="soft_limits"):
        decode(messages.MotorInfo, {**motor, "soft_limits": [1.0]})


@pytest.mark.parametrize(
    "wrong",
    [
        None,
        [],
        7,
        {},
        {**CANCEL, "seq": "7"},
        {**CANCEL, "seq": True},
        {**CANCEL, "seq": 7.5},
        {**CANCEL, "reason": "for fun"},
        {**CANCEL, "boot_id": None},
    ],
)
def test_a_message_that_is_not_of_its_form_is_an_error_that_says_what(wrong: object) -> None:
    with pytest.raises(DecodeError, match="Cancel"):
        decode(messages.Cancel, wrong)


def test_payloads_of_any_kind_end_nothing(caplog: pytest.LogCaptureFixture) -> None:
    async def hear() -> Connection:
        return Connection("mqtt://127.0.0.1:9/m")

    connection = asyncio.run(hear())
    deep = b"[" * 100_000
    for path in ["cs/1/m_code/pending", "presence", "cs/1/m_code/6/cancel", "reply/x", "cs/x/state", "alarm/active"]:
        for payload in [b"\xff\xfe", b"{", deep, b"null", b"[]", b'{"outputs":[{}]}', b'{"seq":1e999}', b"NaN", b""]:
            with caplog.at_level(logging.CRITICAL):
                connection._received(f"tandem/v1/m/{path}", payload, False)
    assert connection.hub.last("cs/1/m_code/pending") is None


def test_a_hub_keeps_so_many_topics_and_a_follower_so_many_messages() -> None:
    async def work() -> None:
        hub = Hub()
        for number in range(TOPICS_MAX + 5):
            hub.publish(f"t/{number}", number)
        assert (hub.last("t/4"), hub.last("t/5")) == (None, 5)
        followed = hub.follow("t/9")
        assert await anext(followed) == 9
        for number in range(BACKLOG_MAX + 3):
            hub.publish("t/9", number)
        assert await anext(followed) == 3, "the oldest have given way"
        hub.close()
        assert [message async for message in followed][-1] == BACKLOG_MAX + 2

    asyncio.run(work())


def test_each_subscribed_topic_has_a_class() -> None:
    for path in (*FILTERS, "reply/x", "handler/x/presence", "handler/x/result"):
        assert form_of(path.replace("io/+", "io/in").replace("+", "1")) is not None, path


def test_a_cancellation_that_comes_together_with_the_answer_is_not_lost() -> None:
    async def work() -> None:
        answer: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        asking = asyncio.create_task(within(answer, 5.0))
        await asyncio.sleep(0)
        answer.set_result(1)
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking

    asyncio.run(work())


def test_what_takes_longer_than_its_time_is_cancelled() -> None:
    async def work() -> None:
        never: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        with pytest.raises(asyncio.TimeoutError):
            await within(never, 0.01)
        assert never.cancelled()

    asyncio.run(work())
