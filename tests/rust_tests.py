#!/usr/bin/env python3
"""Runs all Rust tests of the workspace.

  tests/rust_tests.py     builds the tests, runs their programs, and then the examples in documentation comments

A test that fails is repeated alone. If it then passes, it is reported as flaky, which is a failure too.

The simulated worlds only compute, in simulated time. They run at idle priority next to the other tests, most of which wait.
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

    def start(self, *arguments, **options):
        """Starts tests of the program; its output is a pipe."""
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
        return subprocess.Popen(
            [self.path, *arguments],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            **options,
        )

    def run(self, *arguments):
        """Runs tests of the program; returns the result with its output."""
        begin = time.monotonic()
        return self.wait(self.start(*arguments), begin, *arguments)

    def wait(self, started, begin, *arguments):
        """Waits for the end of started tests; returns the result with its output."""
        output, _ = started.communicate()
        seconds = time.monotonic() - begin
        verdict = "passed" if started.returncode == 0 else "FAILED"
        print(f"{' '.join([str(self), *arguments])}: {verdict} after {seconds:.0f} s", flush=True)
        return subprocess.CompletedProcess(started.args, started.returncode, output)

    def is_of_whole_machines(self):
        return self.package == "tandem" and self.target == "it"

    def only_computes(self):
        """Returns whether this is the program of the simulated worlds, which never wait for real time."""
        return self.target == "worlds"


def test_programs():
    """Builds all tests; returns their programs."""
    command = ["cargo", "test", "--workspace", "--locked", "--no-run", "--message-format=json-render-diagnostics"]
    built = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if built.returncode != 0:
        sys.exit(1)
    messages = [json.loads(line) for line in built.stdout.splitlines() if line.startswith("{")]
    return [Program(message) for message in messages if message.get("executable") and message["profile"]["test"]]


def idle():
    """Gives this process only the processor time that no other process uses."""
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


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
    if len(sys.argv) > 1:
        sys.exit(__doc__)
    programs = test_programs()
    begin = time.monotonic()
    computing = [(program, program.start(preexec_fn=idle)) for program in programs if program.only_computes()]
    found = []
    for program in programs:
        if not program.only_computes():
            found += failures(program, program.run())
    for program, started in computing:
        found += failures(program, program.wait(started, begin))
    if not run_examples():
        found.append("an example in a documentation comment failed")
    print("\n".join(found))
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
