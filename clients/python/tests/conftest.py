"""Fixtures and helpers shared by the tests."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]
"""The checkout."""


@pytest.fixture
def in_loop() -> Callable[[Awaitable[Any]], Any]:
    """Run a coroutine to its end; 30 s are the limit."""

    def run(work: Awaitable[Any]) -> Any:
        async def limited() -> Any:
            return await asyncio.wait_for(work, 30)

        return asyncio.run(limited())

    return run
