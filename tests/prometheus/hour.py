"""No alert is raised within an hour at idle machines: the untouched demo, a machine that has finished, and one that has restarted.

``hour.py RULES``, by tests/prometheus/run. Each machine is real, and what it says in a few seconds goes on for an hour of promtool's
time: a gauge keeps its value, and a counter grows as it does here. TANDEM_BIN is the command.
"""

from __future__ import annotations

import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request

RULES = pathlib.Path(sys.argv[1]).resolve()

# Time between the two readings, s.
READING_S = 10
# Readings of an hour in the interval of the configuration of the page, 5 s.
INTERVAL_S = 5
READINGS = 3600 // INTERVAL_S

LINE = re.compile(r"^(?P<name>\w+)(?:\{(?P<labels>.*)\})? (?P<value>\S+)$", re.MULTILINE)
COUNTER = re.compile(r"_(total|bucket|sum|count)$")


class Demo:
    """The demo machine as a user starts it, except for its ports."""

    def __init__(self, folder: pathlib.Path) -> None:
        said = folder / "out"
        with said.open("w") as out, (folder / "log").open("a") as log:
            command = [os.environ["TANDEM_BIN"], "serve", "--listen", "127.0.0.1:0", "--mqtt-listen", "127.0.0.1:0"]
            self.process = subprocess.Popen(command, cwd=folder, stdout=out, stderr=log)
        end = time.monotonic() + 30
        while not (found := re.search(r"REST +(http\S+)/machine", said.read_text())):
            assert time.monotonic() < end and self.process.poll() is None, (folder / "log").read_text()
            time.sleep(0.1)
        self.api = found[1]

    def read(self, path: str) -> str:
        with urllib.request.urlopen(f"{self.api}/{path}") as answer:
            return str(answer.read().decode())

    def send(self, method: str, path: str, body: bytes, kind: str = "application/json") -> None:
        request = urllib.request.Request(f"{self.api}/{path}", body, {"Content-Type": kind}, method=method)
        urllib.request.urlopen(request).close()

    def until(self, execution: str) -> None:
        end = time.monotonic() + 30
        while json.loads(self.read("cs/1/state"))["execution"] != execution:
            assert time.monotonic() < end, execution
            time.sleep(0.1)

    def end(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(30) == 0

    def values(self) -> dict[str, float]:
        """Values by series, as Prometheus names them."""
        found = LINE.finditer(self.read("metrics"))
        labels = 'job="tandem",instance="mill-1"'
        return {
            f"{one['name']}{{{','.join(filter(None, [labels, one['labels']]))}}}": float(one["value"]) for one in found
        }


def hour_of(demo: Demo) -> list[dict[str, str]]:
    """Every series of a machine, for an hour."""
    begin, first = time.monotonic(), demo.values()
    time.sleep(READING_S)
    last = demo.values()
    readings = (time.monotonic() - begin) / INTERVAL_S
    series = [{"series": 'up{job="tandem",instance="mill-1"}', "values": f"1x{READINGS}"}]
    for name, value in last.items():
        is_counter = COUNTER.search(name.partition("{")[0])
        step = (value - first.get(name, value)) / readings if is_counter else 0
        series.append({"series": name, "values": f"{value:f}+{step:f}x{READINGS}"})
    return series


def check(what: str, demo: Demo, folder: pathlib.Path) -> None:
    """Evaluate the rules over the hour. JSON is YAML."""
    series = hour_of(demo)
    raised = "count by (alertname) (count_over_time(ALERTS[1h]))"
    test = {
        "rule_files": [str(RULES)],
        "evaluation_interval": f"{INTERVAL_S}s",
        "tests": [
            {
                "name": what,
                "interval": f"{INTERVAL_S}s",
                "input_series": series,
                "promql_expr_test": [
                    # an alert that is pending at any time would be raised on a slower
                    # computer
                    {"expr": raised, "eval_time": "1h", "exp_samples": []},
                    {"expr": "count(tandem_execution)", "eval_time": "1h", "exp_samples": [{"labels": "{}", "value": 2}]},
                ],
            }
        ],
    }
    file = folder / "hour.test.json"
    file.write_text(json.dumps(test))
    subprocess.run(["promtool", "test", "rules", str(file)], check=True)
    print(f"{what}: {len(series)} series for an hour, no alert")


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        demo = Demo(folder)
        try:
            check("an untouched demo", demo, folder)
            demo.send("PUT", "programs/77", b"G90 G54\nG01 X1 F6000\nM30\n", "text/plain")
            demo.send("POST", "cs/1/load?wait=1", b'{"program": 77}')
            demo.send("POST", "cs/1/start?wait=1", b"{}")
            demo.until("PROGRAM_COMPLETED")
            check("a machine that has finished", demo, folder)
            demo.end()
            demo = Demo(folder)
            assert 'reason="RESTARTED"' in demo.read("metrics")
            check("a machine that has started again", demo, folder)
        finally:
            demo.process.kill()
            demo.process.wait()


main()
