"""Behind a reverse proxy: who asks and by which scheme is believed of stated proxies, and of nobody else."""

from pathlib import Path

import pytest

from service.settings import Settings
from tests.service.conftest import Api, assert_problem, running_service

FORWARDED = {"x-forwarded-for": "203.0.113.7", "x-forwarded-proto": "https"}


def waits_for(api: Api, headers: dict[str, str]) -> bool:
    """Tell whether whoever asks with these headers has to wait, after many wrong keys that came with FORWARDED."""
    wrong = {"authorization": "Bearer wrong"}
    for _ in range(8):
        api.http.get("/v1/axes", headers=wrong | FORWARDED)
    return api.http.get("/v1/axes", headers=wrong | headers).status_code == 429


def test_a_stated_proxy_says_who_asks(tmp_path: Path) -> None:
    with running_service(tmp_path, trusted_proxies="127.0.0.0/8") as api:
        assert waits_for(api, FORWARDED)
        assert not waits_for(api, FORWARDED | {"x-forwarded-for": "203.0.113.8"})  # another one is not slowed down


def test_nobody_else_is_believed(tmp_path: Path) -> None:
    with running_service(tmp_path, trusted_proxies="192.0.2.1") as api:
        assert waits_for(api, FORWARDED | {"x-forwarded-for": "203.0.113.8"})  # all are one address


def test_without_a_proxy_headers_mean_nothing(tmp_path: Path) -> None:
    with running_service(tmp_path) as api:
        assert api.http.get("/v1/axes", headers=FORWARDED).status_code == 200


def test_behind_a_proxy_loopback_is_not_open(tmp_path: Path) -> None:
    """Everybody who reaches the proxy would reach the service."""
    with running_service(tmp_path, trusted_proxies="127.0.0.1") as api:
        assert_problem(api.http.get("/v1/axes"), 401, "unauthenticated")
        assert api.http.get("/healthz").status_code == 200


def test_browsers_ask_by_tls_again_and_keep_no_answer(tmp_path: Path) -> None:
    named = {"host": "preload.plant:8710"}
    with running_service(tmp_path, trusted_proxies="127.0.0.1", host_names="preload.plant") as api:
        paths = ("/v1/axes", "/healthz", "/login", "/nowhere", "/static/site.css")
        by_tls = [api.http.get(path, headers=FORWARDED | named).headers for path in paths]
        plain = [api.http.get(path, headers=named).headers for path in paths]
        for host in ("localhost:8710", "127.0.0.1", "[::1]:443"):  # other services answer at their other ports
            plain.append(api.http.get("/healthz", headers=FORWARDED | {"host": host}).headers)
    assert {headers["strict-transport-security"] for headers in by_tls} == {"max-age=31536000"}
    assert not any("strict-transport-security" in headers for headers in plain)
    assert [headers.get("cache-control") for headers in by_tls] == ["no-store"] * 4 + [None]


@pytest.mark.parametrize("names", ["proxy", "10.0.0.1,*", "10.0.0.1/8"])
def test_proxies_are_addresses(names: str) -> None:
    with pytest.raises(ValueError, match="expected addresses or networks"):
        Settings(trusted_proxies=names)  # type: ignore[arg-type]
