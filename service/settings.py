"""Read the settings of the service from the environment (``PRELOAD_*``)."""

import ipaddress
import socket
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

from pydantic import Field, SecretStr, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from service.errors import DataFolderError

VERSION = version("preload-monitor")
_HERE = Path(__file__).resolve().parent
#: A wheel holds the bundled sessions; in a source checkout they stand beside the packages.
BUNDLED_SESSIONS = folder if (folder := _HERE / "replay_data").is_dir() else _HERE.parent / "replay_data"


class Settings(BaseSettings):
    """What an operator may set. Each name is read from the environment with the prefix ``PRELOAD_``."""

    model_config = SettingsConfigDict(env_prefix="PRELOAD_", extra="forbid", frozen=True)

    host: str = Field(default="127.0.0.1", description="Address to listen on; loopback unless set.")
    port: int = Field(default=8710, ge=0, le=65535, description="TCP port; 0 takes a free one.")
    data_dir: Path = Field(default=Path("var"), description="Folder of the database and the raw waveforms.")
    database_url: SecretStr | None = Field(
        default=None, description="SQLAlchemy URL; unset means SQLite in data_dir. May hold a password: never logged."
    )
    database_password_file: Path | None = Field(
        default=None, description="File with the password of database_url, which then holds none."
    )
    replay_dir: Path = Field(default=BUNDLED_SESSIONS, description="Folder of recorded sessions offered for replay.")
    max_body_mib: int = Field(default=64, ge=1, le=1024, description="Largest request body that is accepted.")
    max_recording_mib: int = Field(default=1024, ge=1, le=16384, description="Largest recording that is uploaded.")
    max_waiting_requests: int = Field(
        default=64, ge=1, description="More requests with a body at one time are asked to come back."
    )
    max_waiting_jobs: int = Field(
        default=100, ge=1, description="More jobs of one kind that are not done are asked to come back."
    )
    host_names: Annotated[tuple[str, ...], NoDecode] = Field(
        default=(), description="Further names that browsers and programs may ask this service by, with commas between."
    )
    keep_raw_days: int | None = Field(
        default=None, ge=1, le=36500, description="Raw waveforms are let go after so many days; unset: never."
    )
    keep_before_alarm_days: int = Field(
        default=30, ge=0, le=36500, description="Waveforms are kept from so long before the onset of an alarm,"
    )
    keep_after_alarm_days: int = Field(
        default=30, ge=0, le=36500, description="until so long after the measurement that raised it."
    )
    receivers_file: Path | None = Field(default=None, description="TOML file that says who is told of alarms.")
    advice_file: Path | None = Field(default=None, description="TOML file with what else to check next.")
    public_url: str = Field(
        default="http://127.0.0.1:8710", description="Address that receivers find this service at; its name in notices."
    )
    trusted_proxies: Annotated[tuple[str, ...], NoDecode] = Field(
        default=(),
        description="Addresses or networks of reverse proxies that say whom they forward for, with commas between.",
    )
    waveform_url: str | None = Field(
        default=None,
        pattern="^s3://[^/]+(/.*)?$",
        description="s3://bucket/prefix for the raw waveforms; unset means the folder raw in data_dir.",
    )
    log_level: str = Field(default="INFO", pattern="^(DEBUG|INFO|WARNING|ERROR)$")

    @field_validator("host_names", "trusted_proxies", mode="before")
    @classmethod
    def _split(cls, names: object) -> object:
        return tuple(name.strip() for name in names.split(",") if name.strip()) if isinstance(names, str) else names

    @field_validator("trusted_proxies")
    @classmethod
    def _addresses(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            try:
                ipaddress.ip_network(name)
            except ValueError as error:
                raise ValueError(
                    f"expected addresses or networks such as 10.0.0.5 or 10.0.0.0/24; got {name}"
                ) from error
        return names

    def is_on_loopback(self) -> bool:
        """Return whether only this machine reaches the service: a proxy lets others reach it."""
        return not self.trusted_proxies and is_loopback(self.host)

    def own_names(self) -> tuple[str, ...]:
        """Return the names that this service may be asked by; it may be asked by any address."""
        return ("localhost", socket.gethostname(), self.host, *self.host_names)

    def resolved_database_url(self) -> str:
        """Return the database URL, the embedded SQLite file when none is set."""
        if self.database_url is not None:
            url = self.database_url.get_secret_value()
            return url if self.database_password_file is None else _with_password(url, self.database_password_file)
        return f"sqlite:///{(self.data_dir / 'preload.db').resolve()}"


def is_loopback(host: str) -> bool:
    """Return whether a name or an address is that of this machine itself, whose traffic nobody else sees."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _with_password(url: str, file: Path) -> str:
    from sqlalchemy import make_url  # noqa: PLC0415  # most commands have no database

    try:
        password = file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise DataFolderError(f"the password of the database in {file} cannot be read: {error}") from error
    return make_url(url).set(password=password).render_as_string(hide_password=False)
