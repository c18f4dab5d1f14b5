"""Send a notice as a signed CloudEvent over HTTP."""

import base64
import hashlib
import hmac
import json

import httpx

from preload_client.exchange import Transport, exchange
from service.clock import now
from service.operations.notices.receivers import ENCODED, Webhook, read_secret, whom_to_believe
from service.operations.notices.senders import CLOUD_EVENT_TYPE, MOST_BYTES, TIMEOUT_S, NotTakenError, cloud_event
from service.store.tables import NoticeRow

#: What asking again cannot change. Of a receiver that is set up wrongly (401, 403, 404) it can.
_REFUSED_FOR_GOOD = frozenset(range(400, 500)) - {401, 403, 404, 408, 421, 425, 429}


def signature(secret: str, message_id: str, timestamp: str, body: bytes) -> str:
    """Return the signature of a body, as Standard Webhooks has it: HMAC-SHA256 of ``id.timestamp.body``.

    A secret that begins with ``whsec_`` is the base64 of the key, any other is the key itself.
    """
    encoded = secret.removeprefix(ENCODED)
    key = base64.b64decode(encoded) if encoded != secret else secret.encode()
    signed = f"{message_id}.{timestamp}.".encode() + body
    return "v1," + base64.b64encode(hmac.digest(key, signed, hashlib.sha256)).decode()


class WebhookSender:
    """Posts CloudEvents."""

    def __init__(self, webhook: Webhook, source: str) -> None:
        self.name = webhook.name
        self._webhook = webhook
        self._source = source
        self._tls = whom_to_believe(webhook.ca_file)

    def send(self, notice: NoticeRow) -> None:
        """Hand over a notice; raises NotTakenError unless it is answered with 2xx."""
        body = json.dumps(cloud_event(notice, self._source), ensure_ascii=False).encode()
        message_id, timestamp = f"{self._source}/{notice.id}", str(int(now().timestamp()))
        headers = {
            "content-type": CLOUD_EVENT_TYPE,
            "webhook-id": message_id,
            "webhook-timestamp": timestamp,
        }
        if self._webhook.secret_file is not None:
            secret = read_secret(self._webhook.secret_file).get_secret_value()
            headers["webhook-signature"] = signature(secret, message_id, timestamp, body)
        status = self._status(body, headers)
        if not httpx.codes.is_success(status):
            raise NotTakenError(f"answered with {status}", for_good=status in _REFUSED_FOR_GOOD)

    def _status(self, body: bytes, headers: dict[str, str]) -> int:
        """Return the status of the answer; what else is in it is not read, and no redirect is followed."""
        try:
            with (
                exchange(TIMEOUT_S, MOST_BYTES),
                httpx.Client(transport=Transport(self._tls)) as http,
                http.stream("POST", str(self._webhook.url), content=body, headers=headers) as answer,
            ):
                return answer.status_code
        except httpx.HTTPError as error:
            raise NotTakenError(f"no answer: {error}") from error
