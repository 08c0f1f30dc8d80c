"""A client generated from the OpenAPI document, against a machine at ``API``: ``generated.py DOCUMENT``."""

from __future__ import annotations

import importlib
import io
import json
import os
import pkgutil
import sys
from pathlib import Path

import client
from client import Client, api, models
from client.api.commands import post_cs_cs_load
from client.api.m_codes import get_handlers
from client.api.machine import get_machine
from client.api.programs import get_programs, put_programs_number
from client.api.states import get_cs_cs_state
from client.api.values import get_variables_p, put_variables_p
from client.types import File

# every module can be imported
for module in pkgutil.walk_packages(client.__path__, "client."):
    importlib.import_module(module.name)

# every operation exists
document = json.loads(Path(sys.argv[1]).read_text())
operations = {
    operation["operationId"]
    for path in document["paths"].values()
    for operation in path.values()
    if "operationId" in operation
}
made = {
    module.name.rpartition(".")[2] for module in pkgutil.walk_packages(api.__path__, "client.api.") if not module.ispkg
}
assert operations == made, operations ^ made

# a type with a member for each letter is read and written unchanged
for given in [{"A": 5.0}, {"D": 1.0, "H": -2.0}]:
    assert models.Params.from_dict(given).to_dict() == given

with Client(base_url=os.environ["API"]) as machine:
    text = File(payload=io.BytesIO(b"G01 X1 F6000\nM30\n"))
    put_programs_number.sync_detailed(77, client=machine, body=text)
    programs = get_programs.sync(client=machine)
    assert isinstance(programs, models.ProgramList)
    assert 77 in [program.number for program in programs.programs]
    post_cs_cs_load.sync_detailed(
        1, client=machine, body=models.LoadArgs(program=77), wait=models.PostCsCsLoadWait.VALUE_1
    )
    state = get_cs_cs_state.sync(client=machine, cs=1)
    assert isinstance(state, models.StateMessage)
    assert (state.execution, state.program) == (models.Execution.READY, 77)
    refused = post_cs_cs_load.sync(
        1, client=machine, body=models.LoadArgs(program=999), wait=models.PostCsCsLoadWait.VALUE_1
    )
    assert isinstance(refused, models.Problem)
    assert refused.code == "not_found"
    # the address of a write is a required argument
    put_variables_p.sync_detailed(client=machine, body=models.VariableWrite(values=[7.5]), from_=100)
    for address, value in [(0, 0.0), (100, 7.5)]:
        read = get_variables_p.sync(client=machine, from_=address)
        assert isinstance(read, models.VariableValues)
        assert read.values == [value], (address, read)
    assert isinstance(get_machine.sync(client=machine), models.BirthMessage)
    assert isinstance(get_handlers.sync(client=machine), models.HandlerList)
print(f"{len(operations)} operations are there, and a machine was used")
