"""A time limit that never swallows a cancellation, even one that coincides with the result.

Before Python 3.12, :func:`asyncio.wait_for` returns the result in this case, and the cancelled task continues.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

T = TypeVar("T")


async def within(awaited: Awaitable[T], limit_s: float | None) -> T:
    """Wait for an awaitable, at most a time in seconds; after it, the awaitable is cancelled.

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
