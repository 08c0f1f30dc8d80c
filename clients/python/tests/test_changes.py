"""Follows variables and tools as they change, at a real machine."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tandem_plc import Output, Plc, RequestRefused, SequenceProgram, ToolData
from tandem_plc.testing import DEFAULT_CONFIG, Machine

InLoop = Callable[[Awaitable[Any]], Any]

PUBLISHED = """
[[variables.published]]
from = "P200"
count = 4

[[variables.published]]
from = "Q7"
"""


@pytest.fixture
def tandem_config() -> str:
    """Configure the machine to publish variables."""
    return DEFAULT_CONFIG + PUBLISHED


def test_what_a_program_or_another_client_writes_is_published(tandem_machine: Machine, in_loop: InLoop) -> None:
    program = SequenceProgram("cell")

    @program.on(20)
    async def count(_output: Output, plc: Plc) -> None:
        await plc.write_p(201, [7.0])

    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc, Plc.connect(tandem_machine.mqtt) as other:
            changes = plc.p_changes(200, 2)
            assert await anext(changes) == [0.0, 0.0]
            await other.write_p(202, [5.0])
            await other.write_p(200, [1.5])
            assert await anext(changes) == [1.5, 0.0]
            await other.write_p(201, [math.nan])
            assert math.isnan((await anext(changes))[1])
            q = plc.cs(1).q_changes(7)
            assert await anext(q) == [0.0]
            await plc.cs(1).write_q(7, [2.0])
            assert await anext(q) == [2.0]

    in_loop(work())
    with tandem_machine.serve(program):
        tandem_machine.run("P200=3\nM20\nM30")

    async def after() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            async for values in plc.p_changes(200, 2):
                if values == [3.0, 7.0]:
                    return

    in_loop(after())


def test_variables_that_are_not_published_are_refused_with_the_remedy(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            with pytest.raises(
                RequestRefused, match=r'2 variables from P203 on are not published.*from = "P203", count = 2'
            ):
                await anext(plc.p_changes(203, 2))
            with pytest.raises(RequestRefused, match=r"Q8 is not published"):
                await anext(plc.cs(1).q_changes(8))
            for count in (0, 1025):
                with pytest.raises(RequestRefused, match="not published"):
                    await anext(plc.p_changes(200, count))

    in_loop(work())


def test_tools_and_work_offsets_are_published_when_they_change(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            tools, offsets = plc.tool_changes(), plc.cs(1).work_offset_changes()
            assert await anext(tools) == ()
            assert (await anext(offsets))["G54"] == {"X": 0.0, "Y": 0.0, "Z": 0.0}
            tandem_machine.rest("PUT", "/tools", {"tools": [{"id": 3, "radius": 2.0, "length": 41.25}]})
            assert await anext(tools) == (ToolData(id=3, radius=2.0, length=41.25),)
            tandem_machine.rest("PUT", "/cs/1/work_offsets", {"work_offsets": {"G55": {"X": 12.5}}})
            assert (await anext(offsets))["G55"]["X"] == 12.5

    in_loop(work())
