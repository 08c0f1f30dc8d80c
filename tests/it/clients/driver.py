"""Driver for the actions of ``behaviours.toml``, by tandem-plc.

``driver.py ADDRESS REDELIVERY RETURNS_WITHIN_MS ENDS_WITHIN_MS``
"""

from __future__ import annotations

import asyncio
import sys

from tandem_plc import (
    AlarmWords,
    Output,
    Params,
    Plc,
    Redelivery,
    RequestRefused,
    SequenceProgram,
    Serving,
    TandemError,
    UserAlarm,
)

ADDRESS, REDELIVERY = sys.argv[1:3]
RETURNS_WITHIN_S, ENDS_WITHIN_S = (int(ms) / 1000 for ms in sys.argv[3:])
EMPTY = UserAlarm(
    23, "the tank is empty", remedy="Fill the tank.", languages={"de": AlarmWords("der Tank ist leer", "Tank füllen.")}
)

program = SequenceProgram("driver", redelivery=None if REDELIVERY == "none" else Redelivery(REDELIVERY))
program.alarms(EMPTY)
go = asyncio.Semaphore(0)


def say(text: str) -> None:
    print(">", text, flush=True)


def pocket(params: Params) -> float:
    return params.real("A", 1, 24, "the pocket")


@program.on(20, validate=pocket)
async def change(output: Output) -> None:
    b = "" if output.b is None else f" VB{output.b:g}"
    say(f"work M20 VA{pocket(output.params):g}{b}")


@program.on(21)
async def inspect(output: Output) -> None:
    say(f"answer {await output.ask('Shall it go on?', ['yes', 'no'])}")


@program.on(22)
async def work(output: Output) -> None:
    output.progress("it works", 50)
    say("work M22 verify" if output.redelivered else "work M22")
    try:
        await go.acquire()
    except asyncio.CancelledError:
        say(f"cancelled M22 {output.cancel_reason.value if output.cancel_reason else ''}")
        raise
    say("done M22")


@program.on(25, redelivery=Redelivery.REDO)
async def wash(output: Output) -> None:
    done = output.last_checkpoint or 0
    output.checkpoint(done + 3)
    output.progress(f"noted {done + 3}")
    say(f"work M25 from {done}")
    await go.acquire()
    say("done M25")


@program.on(23)
async def no_coolant(_output: Output) -> None:
    raise EMPTY.alarm()


@program.on(24)
async def fails(_output: Output) -> None:
    raise ZeroDivisionError("a mistake of the handler")


async def with_io(plc: Plc, line: str) -> None:
    name, _, value = line.partition(" ")
    if name == "wait":
        now = await plc.io_out("lamp").wait_until(lambda now: now is (value == "on"))
        say(f"io {'on' if now else 'off'}")
        return
    try:
        await plc.io_out(name).set(value == "on" if value in ("on", "off") else float(value))
        say("io set")
    except RequestRefused:
        say("io refused")


async def told(plc: Plc, line: str) -> None:
    verb, _, rest = line.partition(" ")
    mill = plc.cs(1)
    try:
        if verb == "go":
            go.release()
            return
        if verb == "io":
            await with_io(plc, rest)
            return
        if verb == "interlock":
            await mill.set_interlock(rest == "on", "the door is open", source="door")
            say("interlock set")
            return
        if verb == "load":
            await mill.load(int(rest))
        elif verb == "mdi":
            await mill.mdi(rest)
        elif verb == "start":
            await mill.start(command_id=rest or None)
        else:
            await mill.command(verb)
        say(f"{verb} done")
    except RequestRefused as refused:
        say(f"{verb} refused {refused.code}")
    except TandemError as error:
        say(f"{verb} failed {error}")


async def leave(serving: Serving, ended: asyncio.Event) -> None:
    await serving.leave(returns_within_s=RETURNS_WITHIN_S, ends_within_s=ENDS_WITHIN_S)
    ended.set()


async def listen(reader: asyncio.StreamReader, serving: Serving, ended: asyncio.Event) -> None:
    jobs = set()
    while (line := (await reader.readline()).decode().strip()) != "end":
        jobs.add(asyncio.create_task(leave(serving, ended) if line == "leave" else told(serving.plc, line)))
    ended.set()


async def main() -> None:
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    ended = asyncio.Event()
    async with program.serving(ADDRESS) as serving:
        listening = asyncio.create_task(listen(reader, serving, ended))
        await ended.wait()
    listening.cancel()
    say("ended")


asyncio.run(main())
