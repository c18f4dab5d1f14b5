"""Compress answers; files, and the short answers to windows, go as they are."""

from starlette.middleware.gzip import GZipMiddleware
from starlette.types import Receive, Scope, Send

#: Ends of the paths of files: as large as the disk holds, and mostly noise, which no compression makes small. Windows
#: are posted to such a path as well: each answer says a line or two.
_FILES = ("/file", "/session", "/windows")
#: Of a table that is compressed already.
_PACKED = b"format=parquet"
#: Of gzip: the highest takes seven times as long, longer than to find the answer, for a sixth less of it.
LEVEL = 1


class Compression(GZipMiddleware):
    """ASGI middleware: compresses answers but for files, whose size is to be known, so that a part can be asked for."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] == "http" and (scope["path"].endswith(_FILES) or _PACKED in scope["query_string"]):
            await self.app(scope, receive, send)
        else:
            await super().__call__(scope, receive, send)
