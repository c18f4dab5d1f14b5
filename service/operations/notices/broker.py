"""An MQTT broker: where it is, how to log in, and the topics of this installation."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

#: Of a receiver; with MQTT it is also a level of the topics.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]


class Broker(BaseModel):
    """A broker and who logs in to it. Its name stands in every topic: ``preload/<name>/…``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Name
    host: str
    port: Annotated[int, Field(ge=1, le=65535)] | None = Field(default=None, description="1883, with TLS 8883")
    protocol: Literal["5", "3.1.1"] = "5"
    tls: bool = False
    ca_file: Path | None = Field(default=None, description="with TLS: who signs; if unset, those of the system")
    username: str | None = None
    password_file: Path | None = None

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
