#!/usr/bin/env python3
"""Runs all Rust tests of the workspace.

  tests/rust_tests.py     builds the tests, runs their programs, and then the examples in documentation comments

The tests of whole machines (tests/it) wait more than they compute, so the other programs run at the same time. A test
that fails is repeated alone. If it then passes, it is reported as flaky, which is a failure too.
"""

import json
import os
import pathlib
import re
import subprocess
import sys
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
TOOLCHAIN = re.search(r'channel = "(.+)"', (ROOT / "rust-toolchain.toml").read_text())[1]
LIBRARIES = subprocess.check_output(["rustc", "--print", "target-libdir"], cwd=ROOT, text=True).strip()
FAILED = re.compile(r"^test (\S+)(?: - should panic)? \.\.\. FAILED", re.MULTILINE)
PASSED = re.compile(r"^test result: \w+\. (\d+) passed", re.MULTILINE)


class Program:
    """Test program of a package."""

    def __init__(self, message):
        self.path = message["executable"]
        self.folder = pathlib.Path(message["manifest_path"]).parent
        self.package = re.search(r"[/#]([\w-]+)[#@][^#@]*$", message["package_id"])[1]
        self.target = message["target"]["name"]

    def __str__(self):
        return f"tests of {self.package} ({self.target})"

    def run(self, *arguments):
        """Runs tests of the program; returns the result with its output."""
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
        # whole machines have time limits, so they come first
        priority = [] if self.is_of_whole_machines() else ["nice", "-n", "10"]
        return subprocess.run(
            [*priority, self.path, *arguments],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            check=False,
        )

    def is_of_whole_machines(self):
        return self.package == "tandem" and self.target == "it"


def test_programs():
    """Builds all tests; returns their programs."""
    command = ["cargo", "test", "--workspace", "--locked", "--no-run", "--message-format=json-render-diagnostics"]
    built = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if built.returncode != 0:
        sys.exit(1)
    messages = [json.loads(line) for line in built.stdout.splitlines() if line.startswith("{")]
    return [Program(message) for message in messages if message.get("executable") and message["profile"]["test"]]


class Report:
    """Results of all programs."""

    def __init__(self):
        self.printing = threading.Lock()
        self.failures = []

    def run_all(self, programs):
        for program in programs:
            self.run(program)

    def run(self, program):
        begin = time.monotonic()
        ended = program.run()
        seconds = time.monotonic() - begin
        passed = PASSED.search(ended.stdout)
        with self.printing:
            print(f"{program}: {passed[1] if passed else 'none'} passed in {seconds:.0f} s", flush=True)
        if ended.returncode != 0:
            self.repeat_failures(program, ended)

    def repeat_failures(self, program, ended):
        failures = FAILED.findall(ended.stdout)
        found = [] if failures else [f"{program} ended with {ended.returncode}"]
        for test in failures:
            again = program.run("--exact", test)
            verdict = "flaky: it failed, and passed when repeated" if again.returncode == 0 else "failed twice"
            found.append(f"{program}: {test} {verdict}")
        with self.printing:
            print(ended.stdout, flush=True)
            self.failures += found


def run_examples():
    """Runs the examples in documentation comments."""
    command = ["cargo", "test", "--workspace", "--doc", "--locked", "--quiet"]
    return subprocess.run(command, cwd=ROOT, check=False).returncode == 0


def main():
    if len(sys.argv) > 1:
        sys.exit(__doc__)
    programs = test_programs()
    report = Report()
    whole = [program for program in programs if program.is_of_whole_machines()]
    others = [program for program in programs if not program.is_of_whole_machines()]
    beside = threading.Thread(target=report.run_all, args=[whole])
    beside.start()
    report.run_all(others)
    if not run_examples():
        report.failures.append("an example in a documentation comment failed")
    beside.join()
    for failure in report.failures:
        print(failure, flush=True)
    sys.exit(1 if report.failures else 0)


if __name__ == "__main__":
    main()
