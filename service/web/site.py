"""What every page is written with: templates, words of the visitor, and the mark of what is stored when it is read."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

from anyio.to_thread import run_sync
from fastapi import Depends, Request, Response
from fastapi.responses import RedirectResponse
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.http.problems import MEDIA_TYPE
from service.documents.said import N_
from service.web import shown
from service.web.words import words_for

FOLDER = Path(__file__).parent
STATIC = FOLDER / "static"

environment: Final = Environment(
    loader=FileSystemLoader(FOLDER / "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    extensions=["jinja2.ext.i18n"],
    auto_reload=False,  # they are a part of the program: no file is looked at for a page
)
shown.install(environment)

#: The pages that every page leads to.
NAVIGATION: Final = (
    ("/", N_("Fleet")),
    ("/alarms", N_("Alarms")),
    ("/system", N_("System")),
    ("/docs", N_("API")),
)
#: What a page says after a form was taken: the form leads to ``…?done=KEY``. One line for each form.
DONE: Final = {
    "acknowledged": N_("Noted: you have seen the alarm."),
    "trial-begun": N_("The trial axis is being made."),
    "trial-ended": N_("The trial is put away."),
    "logged": N_("The work is in the log, and marked on every chart."),
    "pinned": N_("Kept: no purge removes these waveforms."),
    "unpinned": N_("The rule decides about these waveforms again."),
    "archived": N_("Archived: it is hidden from the fleet, and takes no windows."),
    "taken-back": N_("Taken back: it is in the fleet again, and takes windows."),
    "begun": N_("Begun. You may close this page: the work goes on, and is found at the axis and under System."),
    "cancelled": N_("It was asked to stop. What was done stays done."),
    "settings-saved": N_("The settings are saved."),
    "commented": N_("Your comment stands in the log."),
    "shelved": N_("The alarm rests; until then nobody is told of it."),
    "cleared": N_("The alarm is cleared: a new baseline is learnt from here on."),
    "removed": N_("The files are removed; the windows that were taken from them stay."),
    "lost-motion-entered": N_("The lost motion is entered."),
    "learnt-anew": N_("Its level is learnt anew."),
    "registered": N_("Registered. Now import a recording of it."),
    "import-begun": N_("Its windows are being taken."),
    "fit-begun": N_("The fit has begun."),
    "fit-cancelled": N_("The fit was stopped."),
    "activated": N_("The calibration is in force; a new baseline begins."),
    "judged-anew": N_("Begun: the calibration comes into force when what was measured is judged by it."),
}


class Page:
    """What a route writes its page with."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self.words = words_for(request.headers.get("accept-language", ""))

    def show(
        self, template: str, *, status: int = 200, headers: Mapping[str, str] | None = None, **found: object
    ) -> Response:
        """Write a page in the language of the visitor."""
        return Response(
            written(self._request.scope, template, **found),
            status_code=status,
            media_type="text/html",
            headers={"Vary": "Accept-Language", "Cache-Control": "no-store", **(headers or {})},
        )


async def page(request: Request) -> Page:
    """Give a route what it writes its page with."""
    return Page(request)


PageOf = Annotated[Page, Depends(page)]


def done(path: str, key: str) -> Response:
    """Lead on to a page after a form was taken, which says so (303: to load it again sends nothing twice)."""
    return RedirectResponse(f"{path}?done={key}", status_code=303)


def written(scope: Scope, template: str, **found: object) -> str:
    """Write a page."""
    request, state = Request(scope), scope.get("state", {})
    caller = state.get("caller")
    return environment.get_template(template).render(
        words=words_for(request.headers.get("accept-language", "")),
        mark="" if request.url.path == "/login" else state.get("mark", ""),
        nav=NAVIGATION,
        user=None if caller is None else caller.user,
        may=frozenset() if caller is None else caller.scopes,
        is_open=caller is not None and caller.is_anyone and request.url.path != "/login",
        path=request.url.path,
        said=DONE.get(request.query_params.get("done", "")),
        **found,
    )


class Site:
    """ASGI middleware: marks what is stored before a page is read, and shows people a page where programs get JSON.

    The mark is taken first: whatever changes while the page is read, the page will ask for.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http" or not _is_page(scope):
            await self._app(scope, receive, send)
            return
        state = scope.setdefault("state", {})
        if scope["method"] == "GET":
            state["mark"] = await run_sync(scope["app"].state.services.changes.mark)
        await self._app(scope, receive, _ProblemPage(scope, send))


class _ProblemPage:
    """Sends an answer on; a problem document as a page."""

    def __init__(self, scope: Scope, send: Send) -> None:
        self._scope, self._send = scope, send
        self._start: Message | None = None
        self._body = b""

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = Headers(raw=message["headers"])
            if headers.get("content-type") == MEDIA_TYPE and "content-encoding" not in headers:
                self._start = message
                return
        if self._start is None:
            await self._send(message)
            return
        self._body += message.get("body", b"")
        if not message.get("more_body"):
            await self._as_page(self._start)

    async def _as_page(self, start: Message) -> None:
        problem = json.loads(self._body)
        text = written(self._scope, "problem.html", problem=problem).encode()
        headers = MutableHeaders(raw=list(start["headers"]))
        headers["content-type"], headers["content-length"] = "text/html; charset=utf-8", str(len(text))
        headers["vary"], headers["cache-control"] = "Accept-Language", "no-store"
        await self._send({"type": "http.response.start", "status": start["status"], "headers": headers.raw})
        await self._send({"type": "http.response.body", "body": text})


def _is_page(scope: Scope) -> bool:
    """Tell whether a person asks, in a browser, for something that is no file and no answer for programs."""
    return not scope["path"].startswith(("/v1/", "/static")) and "text/html" in Headers(scope=scope).get("accept", "")
