"""A time limit that loses no cancellation: one that comes together with the result is not passed over.

Before Python 3.12 :func:`asyncio.wait_for` gives the result then, and what was to end goes on.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

T = TypeVar("T")


async def within(awaited: Awaitable[T], limit_s: float | None) -> T:
    """Wait for something, not longer than a time in seconds; what has not ended by then is cancelled.

    Raises:
        asyncio.TimeoutError: the time is over.
    """
    future = asyncio.ensure_future(awaited)
    try:
        await asyncio.wait({future}, timeout=limit_s)
    finally:
        is_over = not future.done()
        if is_over:
            future.cancel()
    if is_over:
        raise asyncio.TimeoutError
    return future.result()
