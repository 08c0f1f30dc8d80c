"""How long an M code takes from its output to the next output, over the embedded broker.

TANDEM_BIN=target/release/tandem python clients/python/bench/m_codes.py [M CODES]
"""

from __future__ import annotations

import itertools
import statistics
import sys

from tandem_plc import Output, SequenceProgram
from tandem_plc.testing import Machine

program = SequenceProgram("bench")


@program.on(20)
async def nothing(_output: Output) -> None: ...


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 960
    machine = Machine()
    try:
        with machine.serve(program):
            moments: list[float] = []
            # the journal is read by 1000 lines: an M code has four
            for _ in range(-(-count // 240)):
                run = machine.run("M20\n" * 241 + "M30\n", timeout_s=120)
                if not run.completed:
                    raise SystemExit(f"the run ended with {run.execution}: {run.alarms}")
                outputs = [float(line["t_s"]) for line in run.events("output")]
                moments += [(after - before) * 1e3 for before, after in itertools.pairwise(outputs)]
        cuts = statistics.quantiles(moments, n=100)
        print(f"{len(moments)} M codes: median {statistics.median(moments):.2f} ms, p99 {cuts[98]:.2f} ms")
    finally:
        machine.close()


if __name__ == "__main__":
    main()
