#!/usr/bin/env bash
# asyncua 2.1.0, Python 3.11: a server compares a value that is under a deadband with the one written before it, and a
# status only where the value has left the deadband.
#
# Guess: a server keeps the deadband as OPC UA Part 4, 7.22.2 has it: exception if |last cached value - current value| >
# AbsoluteDeadband, where "the last cached value is defined as the last value pushed to the queue", and the deadband is
# "in addition for filtering value changes", so that each change of the status is told. 300 down to 200 in steps of 5
# under a deadband of 30 then tells 300, 265, 230.
# Seen: the slow fall is never told. Nor is the value that turns bad, whose null the server cannot subtract (a TypeError
# in its log), nor the same value when it is good again. The client goes on showing the first one as Good.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet asyncua==2.1.0
cat > "$folder/seen.py" <<'PYTHON'
import asyncio
import logging

from asyncua import Client, Server, ua

logging.disable()
BAD = ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadNoCommunication))


class Shown:
    def __init__(self):
        self.told = []

    def datachange_notification(self, node, value, data):
        self.told.append(f"{data.monitored_item.Value.StatusCode.name} {value}")


async def main():
    server = Server()
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0")
    variable = await server.nodes.objects.add_variable(ua.NodeId("v", 2), "2:v", 300.0)
    async with server:
        port = server.bserver._server.sockets[0].getsockname()[1]
        async with Client(f"opc.tcp://127.0.0.1:{port}") as client:
            all_of_it, in_steps = Shown(), Shown()
            node = client.get_node(variable.nodeid)
            await (await client.create_subscription(10, all_of_it)).subscribe_data_change(node)
            await (await client.create_subscription(10, in_steps)).deadband_monitor(node, 30.0)
            for value in (*range(295, 199, -5), BAD, 200):
                await variable.write_value(float(value) if value is not BAD else BAD)
            while all_of_it.told[-2:] != ["BadNoCommunication None", "Good 200.0"]:
                await asyncio.sleep(0.01)
            await asyncio.sleep(0.5)
            print("without a filter:", len(all_of_it.told), "told, the last three:", *all_of_it.told[-3:], sep="; ")
            print("deadband 30:", *in_steps.told, sep="; ")


asyncio.run(main())
PYTHON
"$folder/venv/bin/python" "$folder/seen.py" 2> /dev/null | grep -v '^Endpoints' > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
without a filter:; 23; told, the last three:; Good 200.0; BadNoCommunication None; Good 200.0
deadband 30:; Good 300.0
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
