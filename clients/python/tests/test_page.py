"""The page of the book: code copied from it works unchanged."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from conftest import ROOT

PAGE = ROOT / "docs/src/how-to/python.md"


def test_the_programs_of_the_page_are_right_and_its_tests_pass(tmp_path: Path) -> None:
    files = re.findall(r"```python,file=(\S+)\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert {name for name, _ in files} == {"changer.py", "test_changer.py", "cell.py", "line.py"}
    for name, text in files:
        (tmp_path / name).write_text(text)
    for module in ["cell", "line"]:
        subprocess.run([sys.executable, "-c", f"import {module}"], cwd=tmp_path, check=True)
    tests = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert tests.returncode == 0, tests.stdout + tests.stderr
    assert "3 passed" in tests.stdout
