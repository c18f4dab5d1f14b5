#!/usr/bin/env bash
# fastapi 0.165.0, Python 3.11: the first request of an application makes each route of the routers that it passes again.
#
# Guess: a route is made where it is decorated, and what is left of `include_router` is done when it is called: the first
# request costs what the second does.
# Seen: `include_router` does nothing but note the router (so since 0.137). The first request that comes to it looks at
# all parameters of all its routes once more, of routes that it does not ask for, too; so does the first request of each
# further application that the same routers are included in. Of routes that are put into the application itself
# (`app.router.routes += router.routes`) none is made again, and both answer the same.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3.11}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet fastapi==0.165.0 httpx==0.28.1
cat > "$folder/seen.py" <<'PYTHON'
import asyncio
import sys

import fastapi.dependencies.utils
import httpx
from fastapi import APIRouter, FastAPI

looked_at = 0

def count(frame, event, _):
    global looked_at
    if event == "call" and frame.f_code is fastapi.dependencies.utils.analyze_param.__code__:
        looked_at += 1

def since():
    global looked_at
    n, looked_at = looked_at, 0
    return n

async def get(app, path):
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://here") as client:
        return (await client.get(path)).json()

sys.setprofile(count)
router = APIRouter()
for number in range(100):
    @router.get(f"/{number}/{{name}}")
    async def answer(name: str, size: int = 1):
        return f"{name} {size}"
print("parameters looked at while 100 routes are decorated:", since())
for kind in ("included", "included in a second application", "put in"):
    app = FastAPI()
    if kind == "put in":
        app.router.routes += router.routes
    else:
        app.include_router(router)
    made, first = since(), asyncio.run(get(app, "/0/a?size=3"))
    at_first, second = since(), asyncio.run(get(app, "/0/a?size=3"))
    print(f"{kind}: {made}, at the first request {at_first}, at the second {since()}; {first == second == 'a 3'}")
sys.setprofile(None)
PYTHON
"$folder/venv/bin/python" "$folder/seen.py" > "$folder/seen"
cat > "$folder/expected" <<'TEXT'
parameters looked at while 100 routes are decorated: 200
included: 0, at the first request 200, at the second 0; True
included in a second application: 0, at the first request 200, at the second 0; True
put in: 0, at the first request 0, at the second 0; True
TEXT
diff "$folder/expected" "$folder/seen" && cat "$folder/seen"
