"""Send a notice to one receiver: a signed CloudEvent over HTTP, or a mail."""

import base64
import hashlib
import hmac
import json
import smtplib
from email.message import EmailMessage
from typing import Protocol

from service.clock import now, text_of
from service.json_types import JsonObject
from service.operations.notices.receivers import ENCODED, Mail, Webhook, read_secret
from service.store.tables import NoticeRow

TIMEOUT_S = 20.0
#: Of a CloudEvent in structured mode.
CLOUD_EVENT_TYPE = "application/cloudevents+json; charset=utf-8"
#: What asking again cannot change. Of a receiver that is set up wrongly (401, 403, 404) it can.
_REFUSED_FOR_GOOD = frozenset(range(400, 500)) - {401, 403, 404, 408, 421, 425, 429}


class NotTakenError(Exception):
    """A receiver did not take a notice."""

    def __init__(self, sentence: str, *, for_good: bool = False) -> None:
        super().__init__(sentence)
        self.for_good = for_good


class Sender(Protocol):
    """A way to one receiver."""

    name: str

    def send(self, notice: NoticeRow) -> None:
        """Hand over a notice; raises NotTakenError."""


def cloud_event(notice: NoticeRow, source: str) -> JsonObject:
    """Return a notice as a CloudEvent 1.0 in structured mode. Its id stays when it is sent again."""
    return {
        "specversion": "1.0",
        "id": str(notice.id),
        "source": source,
        "type": notice.kind,
        "subject": notice.subject,
        "time": text_of(notice.at),
        "datacontenttype": "application/json",
        "data": notice.content,
    }


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
        import httpx  # noqa: PLC0415  # a service that calls no webhook is lighter by it

        try:
            answer = httpx.post(
                str(self._webhook.url), content=body, headers=headers, timeout=TIMEOUT_S, trust_env=False
            )
        except httpx.HTTPError as error:
            raise NotTakenError(f"no answer: {error}") from error
        if not answer.is_success:
            raise NotTakenError(f"answered with {answer.status_code}", for_good=answer.status_code in _REFUSED_FOR_GOOD)


class MailSender:
    """Sends mails in plain text."""

    def __init__(self, mail: Mail, source: str) -> None:
        self.name = mail.name
        self._mail = mail
        self._source = source

    def send(self, notice: NoticeRow) -> None:
        """Hand over a notice to the mail server; raises NotTakenError if it does not take it."""
        mail = self._mail
        try:
            with smtplib.SMTP(mail.host, mail.port, timeout=TIMEOUT_S) as server:
                if mail.start_tls:
                    server.starttls()
                if mail.username is not None and mail.password_file is not None:
                    server.login(mail.username, read_secret(mail.password_file).get_secret_value())
                server.send_message(self.message(notice))
        except (OSError, smtplib.SMTPException) as error:
            for_good = isinstance(error, smtplib.SMTPRecipientsRefused | smtplib.SMTPDataError)
            raise NotTakenError(f"the mail server did not take it: {error}", for_good=for_good) from error

    def message(self, notice: NoticeRow) -> EmailMessage:
        """Return the mail. Its Message-ID stays when it is sent again, so that a mail server can tell."""
        message, content = EmailMessage(), notice.content
        happened = notice.kind.rpartition(".")[2]
        message["From"], message["To"] = self._mail.sender, ", ".join(self._mail.recipients)
        message["Subject"] = f"{content.get('axis')}: alarm {content.get('alarm')} {happened}"
        message["Message-ID"] = f"<{notice.id}.{hashlib.sha256(self._source.encode()).hexdigest()[:16]}@preload>"
        message["Date"] = notice.at
        lines = [
            content.get("sentence"),
            f"Cause: {content.get('cause')}",
            f"Next: {content.get('check_next')}",
            f"Why this mail: {content.get('reason')}",
            f"{self._source}/axes/{content.get('axis')}",
        ]
        message.set_content("\n\n".join(str(line) for line in lines if line))
        return message
