#!/usr/bin/env bash
# starlette 1.10.0, Python 3.11: whether the background task of a streamed answer runs after its client has left depends
# on how the server tells it, and so on the version of ASGI that the server speaks.
#
# Guess: a background task runs once the answer is over, however it ended: a client that leaves in the middle is no fault
# of the application, which sees the same error either way, or none.
# Seen: where the server says `http.disconnect` (ASGI 2.3) the stream is cancelled, no error is seen and the task runs.
# Where `send` raises OSError the task does not run: with 2.3 that OSError is seen, with 2.4 a ClientDisconnect without a
# text in its place. An answer that is not streamed passes the OSError on and leaves its task out with both.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet starlette==1.10.0
cat > "$folder/seen.py" <<'PYTHON'
import asyncio
from starlette.background import BackgroundTask
from starlette.responses import Response, StreamingResponse


async def parts():
    while True:
        yield b"part"
        await asyncio.sleep(0.01)

async def leave(kind, version, by):
    ran, gone = [], asyncio.Event()
    task = BackgroundTask(lambda: ran.append(True))
    answer = Response(b"whole", background=task) if kind == "whole" else StreamingResponse(parts(), background=task)

    async def receive():
        await gone.wait()
        return {"type": "http.disconnect"}

    async def send(message):
        if message["type"] == "http.response.body":
            if by == "send":
                raise OSError("the client has left")
            gone.set()

    seen = "no error"
    try:
        await answer({"type": "http", "asgi": {"spec_version": version}}, receive, send)
    except Exception as error:
        seen = repr(error)
    print(f"{kind}, ASGI {version}, told by {by}: {seen}, task ran: {bool(ran)}")


asyncio.run(leave("streamed", "2.3", "receive"))
for kind, version in (("streamed", "2.3"), ("streamed", "2.4"), ("whole", "2.3"), ("whole", "2.4")):
    asyncio.run(leave(kind, version, "send"))
PYTHON
"$folder/venv/bin/python" "$folder/seen.py" > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
streamed, ASGI 2.3, told by receive: no error, task ran: True
streamed, ASGI 2.3, told by send: OSError('the client has left'), task ran: False
streamed, ASGI 2.4, told by send: ClientDisconnect(), task ran: False
whole, ASGI 2.3, told by send: OSError('the client has left'), task ran: False
whole, ASGI 2.4, told by send: OSError('the client has left'), task ran: False
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
