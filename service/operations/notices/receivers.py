"""Read who outside is told of alarms: webhooks, mail and MQTT brokers of one TOML file."""

import base64
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, HttpUrl, SecretStr, ValidationError, field_validator, model_validator

from service.errors import DataFolderError, first_refusal
from service.settings import is_loopback

if TYPE_CHECKING:
    from ssl import SSLContext

#: A secret that begins so is the base64 of a key, as Standard Webhooks writes it.
ENCODED = "whsec_"
Address = Annotated[str, Field(pattern=r"^[^@\s]+@[^@\s]+$", max_length=254)]


#: Of a receiver; with MQTT it is also a level of the topics.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]


class Server(BaseModel):
    """A server outside, who logs in to it, and whom to believe that it is it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Name
    host: str
    ca_file: Path | None = Field(default=None, description="with TLS: who signs; if unset, those of the system")
    username: str | None = None
    password_file: Path | None = None
    password_in_clear: bool = Field(default=False, description="send the password without TLS, for everybody to hear")

    @property
    def encrypts(self) -> bool:
        """Whether it is spoken to by TLS."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _keeps_its_password(self) -> Self:
        if self.ca_file is not None and not self.encrypts:
            raise ValueError(f"ca_file is for TLS, which is off; switch it on: {self._SWITCH} = true")
        if self.password_file is None or self.encrypts or self.password_in_clear or is_loopback(self.host):
            return self
        raise ValueError(
            f"the password would go to {self.host} without TLS; set {self._SWITCH} = true, "
            "or password_in_clear = true if everybody on the way may have it"
        )

    _SWITCH: ClassVar[str]


class Broker(Server):
    """A broker and who logs in to it. Its name stands in every topic: ``preload/<name>/…``."""

    _SWITCH = "tls"

    port: Annotated[int, Field(ge=1, le=65535)] | None = Field(default=None, description="1883, with TLS 8883")
    protocol: Literal["5", "3.1.1"] = "5"
    tls: bool = False

    @property
    def encrypts(self) -> bool:
        """Whether it is spoken to by TLS."""
        return self.tls

    @property
    def is_5(self) -> bool:
        """Whether messages carry properties and answers carry reasons."""
        return self.protocol == "5"

    @property
    def resolved_port(self) -> int:
        """The TCP port."""
        return self.port or (8883 if self.tls else 1883)

    @property
    def root(self) -> str:
        """The level above all topics."""
        return f"preload/{self.name}"

    @property
    def status_topic(self) -> str:
        """Where it stands whether the service is connected."""
        return f"{self.root}/status"

    def axis_topic(self, axis: str, kind: str) -> str:
        """Return a topic of an axis."""
        return f"{self.root}/axes/{axis}/{kind}"


class Webhook(BaseModel):
    """Somebody who takes CloudEvents over HTTP, each signed with a secret that both know."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Name
    url: HttpUrl
    ca_file: Path | None = Field(default=None, description="who signs for https; if unset, those of the system")
    secret_file: Path | None = None

    @field_validator("url")
    @classmethod
    def _keeps_its_password(cls, url: HttpUrl) -> HttpUrl:
        if url.password is not None and url.scheme == "http" and not is_loopback(url.host or ""):
            raise ValueError(f"the password in it would go to {url.host} without TLS; use https")
        return url


class Mail(Server):
    """People who get a mail by way of a mail server."""

    _SWITCH = "start_tls"

    port: Annotated[int, Field(ge=1, le=65535)] = 25
    sender: Annotated[Address, Field(alias="from")]
    recipients: Annotated[list[Address], Field(alias="to", min_length=1)]
    start_tls: bool = False

    @property
    def encrypts(self) -> bool:
        """Whether it is spoken to by TLS."""
        return self.start_tls


class Receivers(BaseModel):
    """All of them; no two have one name."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    webhook: list[Webhook] = []
    mail: list[Mail] = []
    mqtt: list[Broker] = []

    @model_validator(mode="after")
    def _different(self) -> "Receivers":
        receivers: list[Webhook | Mail | Broker] = [*self.webhook, *self.mail, *self.mqtt]
        names = [receiver.name for receiver in receivers]
        if len(set(names)) < len(names):
            raise ValueError(f"receivers must have different names; got {', '.join(names)}")
        return self


def read_receivers(path: Path | None) -> Receivers:
    """Return the receivers of a file, none where there is no file.

    Raises DataFolderError, with one sentence, if the file or a file of a secret cannot be read or means nothing.
    """
    if path is None:
        return Receivers()
    try:
        receivers = Receivers.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DataFolderError(f"the receivers in {path} cannot be read: {error}") from error
    except ValidationError as error:
        raise DataFolderError(f"the receivers in {path}: {first_refusal(error, shows_input=False)}") from error
    logins: list[Mail | Broker] = [*receivers.mail, *receivers.mqtt]
    for file in (*(each.secret_file for each in receivers.webhook), *(each.password_file for each in logins)):
        if file is not None:
            read_secret(file)
    for ca_file in (*(each.ca_file for each in receivers.webhook), *(each.ca_file for each in logins)):
        if ca_file is not None:
            whom_to_believe(ca_file)
    return receivers


def whom_to_believe(ca_file: Path | str | None) -> "SSLContext":
    """Return what TLS verifies by. Raises DataFolderError if the file holds no certificate of an authority."""
    from preload_client.exchange import tls_context  # noqa: PLC0415  # brings an HTTP client

    try:
        return tls_context(ca_file)
    except OSError as error:
        raise DataFolderError(str(error)) from error


def read_secret(path: Path) -> SecretStr:
    """Return the first line of a file. Raises DataFolderError if there is none."""
    try:
        secret = path.read_text(encoding="utf-8").partition("\n")[0].strip()
    except (OSError, UnicodeDecodeError) as error:
        raise DataFolderError(f"the secret in {path} cannot be read: {error}") from error
    if not secret:
        raise DataFolderError(f"the secret in {path} is empty")
    if secret.startswith(ENCODED):
        try:
            base64.b64decode(secret.removeprefix(ENCODED), validate=True)
        except ValueError as error:
            raise DataFolderError(f"the secret in {path} begins with {ENCODED} and is not base64 after it") from error
    return SecretStr(secret)
