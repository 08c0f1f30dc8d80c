#!/usr/bin/env python3
"""Runs all Rust tests of the workspace.

  tests/rust_tests.py           builds the tests, runs their programs, and then the examples in documentation comments
  tests/rust_tests.py worlds    only the simulated worlds
  tests/rust_tests.py others    all but the simulated worlds

A test that fails is repeated alone. If it then passes, it is reported as flaky, which is a failure too.
"""

import json
import os
import pathlib
import re
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
TOOLCHAIN = re.search(r'channel = "(.+)"', (ROOT / "rust-toolchain.toml").read_text())[1]
LIBRARIES = subprocess.check_output(["rustc", "--print", "target-libdir"], cwd=ROOT, text=True).strip()
FAILED = re.compile(r"^test (\S+)(?: - should panic)? \.\.\. FAILED", re.MULTILINE)
PASSED_ONE = re.compile(r"^test result: ok\. 1 passed", re.MULTILINE)


class Program:
    """Test program of a package."""

    def __init__(self, message):
        self.path = message["executable"]
        self.folder = pathlib.Path(message["manifest_path"]).parent
        self.package = re.search(r"[/#]([\w-]+)[#@][^#@]*$", message["package_id"])[1]
        self.target = message["target"]["name"]

    def __str__(self):
        return f"tests of {self.package} ({self.target})"

    def execute(self, *arguments):
        """Executes tests of the program; returns the result with its output."""
        environment = {
            "RUST_TEST_THREADS": str(max(3, os.cpu_count() or 1)),
            "PROPTEST_RNG_SEED": "20",
            "TANDEM_BIN": str(TARGET / "debug/tandem"),
            **os.environ,
            # as cargo does: tests of the compiler read the folder, and projects of readers are built by this compiler
            "CARGO_MANIFEST_DIR": str(self.folder),
            "RUSTUP_TOOLCHAIN": TOOLCHAIN,
            # the program of a derive macro needs the libraries of the compiler
            "LD_LIBRARY_PATH": LIBRARIES,
        }
        return subprocess.run(
            [self.path, *arguments],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            check=False,
        )

    def run(self, *arguments):
        """Runs tests of the program, and prints their time; returns the result with its output."""
        begin = time.monotonic()
        ended = self.execute(*arguments)
        seconds = time.monotonic() - begin
        verdict = "passed" if ended.returncode == 0 else "FAILED"
        print(f"{' '.join([str(self), *arguments])}: {verdict} after {seconds:.0f} s", flush=True)
        return ended

    def is_of_whole_machines(self):
        return self.package == "tandem" and self.target == "it"

    def is_of_worlds(self):
        return self.target == "worlds"


def test_programs():
    """Builds all tests; returns their programs."""
    command = ["cargo", "test", "--workspace", "--locked", "--no-run", "--message-format=json-render-diagnostics"]
    built = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if built.returncode != 0:
        sys.exit(1)
    messages = [json.loads(line) for line in built.stdout.splitlines() if line.startswith("{")]
    return [Program(message) for message in messages if message.get("executable") and message["profile"]["test"]]


def failures(program, ended):
    """Returns a line for each failure of a program that has ended."""
    if ended.returncode == 0:
        return []
    print(ended.stdout, flush=True)
    failed = FAILED.findall(ended.stdout)
    return [repeated(program, test) for test in failed] or [f"{program}: ended with {ended.returncode}"]


def repeated(program, test):
    """Repeats a failed test alone; returns what this shows."""
    is_flaky = PASSED_ONE.search(program.run("--exact", test).stdout)
    return f"{program}: {test} {'is flaky: it passed when repeated' if is_flaky else 'failed twice'}"


def run_examples():
    """Runs the examples in documentation comments."""
    command = ["cargo", "test", "--workspace", "--doc", "--locked", "--quiet"]
    return subprocess.run(command, cwd=ROOT, check=False).returncode == 0


def main():
    wanted = sys.argv[1:]
    if wanted not in ([], ["worlds"], ["others"]):
        sys.exit(__doc__)
    found = []
    for program in test_programs():
        if not wanted or program.is_of_worlds() == (wanted == ["worlds"]):
            found += failures(program, program.run())
    if wanted != ["worlds"] and not run_examples():
        found.append("an example in a documentation comment failed")
    print("\n".join(found))
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
