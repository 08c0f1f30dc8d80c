"""A real Prometheus reads a served machine: it can answer every query of the dashboard and of the alerts.

Run by tests/prometheus/run in the folder of the machine; API is its REST interface.
"""

import json
import os
import pathlib
import re
import socket
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request

api = os.environ["API"]
monitoring = pathlib.Path(sys.argv[1])


def post(path: str, body: dict[str, object]) -> None:
    data = json.dumps(body).encode()
    request = urllib.request.Request(f"{api}/{path}", data, {"Content-Type": "application/json"})
    urllib.request.urlopen(request).close()


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def config(target: str) -> str:
    """The configuration of the page, for a local machine without a token."""
    text = (monitoring / "prometheus.yml").read_text()
    text, without = re.subn(r"    authorization:\n.*\n", "", text)
    text, named = re.subn(r'targets: \[".*"\]', f'targets: ["{target}"]', text)
    assert (without, named) == (1, 1), text
    return text.replace("scrape_interval: 5s", "scrape_interval: 1s").replace("evaluation_interval: 5s", "evaluation_interval: 1s")


def main() -> None:
    host = urllib.parse.urlparse(api).netloc
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        (pathlib.Path(folder) / "prometheus.yml").write_text(config(host))
        (pathlib.Path(folder) / "alerts.yml").write_text((monitoring / "alerts.yml").read_text())
        prometheus = subprocess.Popen(
            ["prometheus", f"--config.file={folder}/prometheus.yml", f"--storage.tsdb.path={folder}/data"]
            + [f"--web.listen-address=127.0.0.1:{port}", "--log.level=error"]
        )
        try:
            watch(port)
        finally:
            prometheus.terminate()
            prometheus.wait()


def watch(port: int) -> None:
    def query(expression: str) -> list[dict[str, object]]:
        url = f"http://127.0.0.1:{port}/api/v1/query?" + urllib.parse.urlencode({"query": expression})
        with urllib.request.urlopen(url) as answer:
            found = json.load(answer)
        assert found["status"] == "success", found
        return list(found["data"]["result"])

    def until(what: str, holds) -> None:
        end = time.monotonic() + 60
        while time.monotonic() < end:
            try:
                if holds():
                    return
            except OSError:
                pass
            time.sleep(0.2)
        raise AssertionError(what)

    until("Prometheus reads the machine", lambda: query('up{job="tandem"} == 1'))
    # a program waits for a handler that does nothing, so that each query of the dashboard has a result
    told = re.search(r"mqtt://([^:]+):(\d+)", pathlib.Path("out").read_text())
    assert told, "the machine does not tell its broker"
    presence = json.dumps({"online": True, "handles": [{"cs": 1, "m": 77}]})
    topic = "tandem/v1/mill-1/handler/idle/presence"
    subprocess.run(["mosquitto_pub", "-h", told[1], "-p", told[2], "-q", "1", "-r", "-t", topic, "-m", presence], check=True)
    until("the handler is known", lambda: query('tandem_handler_online{handler="idle"} == 1'))
    program = b"G90 G54\nG01 X10 F3000\nM77\nM30\n"
    urllib.request.urlopen(urllib.request.Request(f"{api}/programs/77", program, method="PUT")).close()
    post("cs/1/runs", {"program": 77, "parts": 2})
    until("the open M code is read", lambda: query('tandem_m_code_open_seconds{cs="1",m="77"}'))
    assert query('tandem_execution{cs="1",execution="WAIT"}'), query("tandem_execution")
    dashboard = json.loads((monitoring / "grafana" / "dashboard.json").read_text())
    queries = [target["expr"].replace("$machine", ".*") for panel in dashboard["panels"] for target in panel["targets"]]
    assert len(queries) > 10, queries
    until("rates have two values", lambda: all(query(one) for one in queries if "rate(" in one or "increase(" in one))
    empty = [one for one in queries if not query(one)]
    assert not empty, f"nothing to show: {empty}"
    rules = re.findall(r"^ *expr: (.*)$", (monitoring / "alerts.yml").read_text(), re.MULTILINE)
    names = {name for rule in rules for name in re.findall(r"\b(?:up|tandem_\w+)\b", rule)} - {"tandem"}
    # metrics that only a fault produces do not occur here; promtool tests them with alerts.test.yml
    missing = [name for name in names - {"tandem_alarms_active"} if not query(name)]
    assert not missing, f"no such metric: {missing}"
    url = f"http://127.0.0.1:{port}/api/v1/alerts"
    with urllib.request.urlopen(url) as answer:
        alerts = json.load(answer)["data"]["alerts"]
    # these alerts report lateness, which also occurs on a computer that runs other tests at the same
    # time
    late = ("ServoLate", "ServoLosesCycles")
    firing = [alert for alert in alerts if alert["state"] == "firing" and alert["labels"]["alertname"] not in late]
    assert not firing, firing
    print(f"{len(queries)} queries of the dashboard have values; {len(rules)} alerts, none raised without a cause")


main()
