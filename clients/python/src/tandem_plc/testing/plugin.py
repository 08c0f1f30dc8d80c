"""The fixture ``tandem_machine`` of pytest, available wherever this package is installed."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from . import DEFAULT_CONFIG, Machine


@pytest.fixture
def tandem_config() -> str:
    """Configuration of ``tandem_machine``; a fixture of this name in the tests overrides it."""
    return DEFAULT_CONFIG


@pytest.fixture
def tandem_machine(tandem_config: str) -> Iterator[Machine]:
    """A simulated machine of the test's own: ``with tandem_machine.serve(program): tandem_machine.run("M06 VA5")``."""
    machine = Machine(tandem_config)
    try:
        yield machine
    finally:
        machine.close()
