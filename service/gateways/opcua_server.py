"""An OPC UA server that shows the axes of a service; it reads the service over HTTP and writes nothing to it."""

import asyncio
import logging
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Self

from asyncua import Server, ua
from pydantic import Field, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from preload_client import AsyncClient
from service.gateways.opcua_login import OneUser, Sessions
from service.gateways.opcua_nodes import SEVERITY, Nodes
from service.gateways.opcua_reading import READ_WITHIN_S, ServiceAwayError, read_service
from service.gateways.opcua_subscriptions import tell_what_holds
from service.operations.notices.receivers import read_secret
from service.settings import is_loopback

log = logging.getLogger(__name__)

#: So often the service is read.
POLL_S = 2.0


class OpcuaSettings(BaseSettings):
    """What an operator may set. Each name is read from the environment with the prefix ``PRELOAD_OPCUA_``."""

    model_config = SettingsConfigDict(env_prefix="PRELOAD_OPCUA_", extra="forbid", frozen=True)

    host: str = "127.0.0.1"
    port: int = Field(default=4840, ge=1, le=65535)
    certificate_file: Path | None = None
    private_key_file: Path | None = None
    username: str | None = None
    password_file: Path | None = None

    @property
    def is_secured(self) -> bool:
        """Whether clients have to encrypt and to log in."""
        return None not in (self.certificate_file, self.private_key_file, self.username, self.password_file)

    @model_validator(mode="after")
    def _secured_where_others_reach_it(self) -> Self:
        given = (self.certificate_file, self.private_key_file, self.username, self.password_file)
        if any(given) and not self.is_secured:
            raise ValueError("certificate_file, private_key_file, username and password_file are given together")
        if not is_loopback(self.host) and not self.is_secured:
            raise ValueError("beyond loopback it needs certificate_file, private_key_file, username and password_file")
        return self


async def serve_opcua(
    settings: OpcuaSettings, url: str, key: str | None, stopping: asyncio.Event, ca_file: str | None = None
) -> None:
    """Show a service until it is to stop; from the first answer on, so that whoever connects finds the nodes."""
    server = await new_server(settings)
    service = AsyncClient(url, key, retries=0, timeout_s=READ_WITHIN_S, ca_file=ca_file)
    async with service, AsyncExitStack() as listening:
        nodes, is_open = await Nodes.make(server), False
        while not stopping.is_set():
            try:
                await nodes.show(await read_service(service))
                if not is_open:
                    await listening.enter_async_context(server)
                    is_open = True
                    log.info("OPC UA: %s", server.endpoint.geturl())
            except ServiceAwayError as error:
                log.warning("%s", error)
                await nodes.show_away()
            try:
                await asyncio.wait_for(stopping.wait(), POLL_S)
            except TimeoutError:
                continue


async def new_server(settings: OpcuaSettings) -> Server:
    """Return a server that does not listen yet."""
    users, policy = None, ua.SecurityPolicyType.NoSecurity
    if settings.username is not None and settings.password_file is not None:
        users = OneUser(settings.username, read_secret(settings.password_file).get_secret_value())
        policy = ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt
    server = Server(iserver=Sessions(user_manager=users))
    tell_what_holds(server)
    server.iserver.bind_condition_methods = SEVERITY  # ConditionRefresh; its own events have a severity, too
    await server.init()
    server.set_endpoint(f"opc.tcp://{settings.host}:{settings.port}/preload")
    server.set_server_name("Preload Monitor")
    server.set_security_policy([policy])
    server.set_identity_tokens([ua.AnonymousIdentityToken if users is None else ua.UserNameIdentityToken])
    if settings.certificate_file is not None and settings.private_key_file is not None:
        await server.load_certificate(settings.certificate_file)
        await server.load_private_key(settings.private_key_file)
    return server
