"""``/login``: a form for name and password, and ``/logout``."""

from typing import Annotated
from urllib.parse import urlsplit

from fastapi import APIRouter, Form, Request, Response
from fastapi.responses import RedirectResponse
from pydantic import BaseModel, Field

from service.api.access import COOKIE, address_of
from service.api.services import ServicesOf
from service.clock import now
from service.errors import TooManyTriesError, UnauthenticatedError
from service.operations.access.passwords import LONGEST_PASSWORD
from service.web.site import PageOf

router = APIRouter(include_in_schema=False)


class LoginForm(BaseModel):
    """What the page sends."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    password: Annotated[str, Field(min_length=1, max_length=LONGEST_PASSWORD)]
    next: Annotated[str, Field(max_length=400)] = "/"


@router.get("/login")
def login_page(page: PageOf, next: str = "/") -> Response:  # noqa: A002 - what the field of the form is called
    """Show the form."""
    return page.show("login.html", next=_own_path(next), refusal=None, name="")


@router.post("/login")
def log_in(request: Request, page: PageOf, form: Annotated[LoginForm, Form()], on: ServicesOf) -> Response:
    """Log in, and go on to the page that was asked for."""
    request.state.who = on.access.name_of(form.name)
    try:
        token, expires_at = on.access.log_in(form.name, form.password, address_of(request.scope))
    except (UnauthenticatedError, TooManyTriesError) as error:
        wait = {"Retry-After": error.retry_after} if isinstance(error, TooManyTriesError) else None
        return page.show(
            "login.html",
            next=_own_path(form.next),
            refusal=str(error),
            name=form.name,
            status=429 if wait else 401,
            headers=wait,
        )
    answer = RedirectResponse(_own_path(form.next), status_code=303)
    answer.set_cookie(
        COOKIE,
        token,
        max_age=int((expires_at - now()).total_seconds()),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )
    return answer


@router.post("/logout")
def log_out(request: Request, on: ServicesOf) -> Response:
    """Log out."""
    token = request.cookies.get(COOKIE)
    if token is not None:
        on.access.log_out(token)
    answer = RedirectResponse("/login", status_code=303)
    answer.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return answer


def _own_path(path: str) -> str:
    """Return a path of this service; its first page for anything that leads elsewhere."""
    parts = urlsplit(path.replace("\\", "/"))
    return parts.path if parts.path.startswith("/") and not parts.netloc and not parts.path.startswith("//") else "/"
