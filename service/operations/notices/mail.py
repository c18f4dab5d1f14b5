"""Send a notice as a mail."""

import hashlib
import smtplib
import socket
from email.message import EmailMessage

from preload_client.exchange import connect, exchange
from service.operations.notices.receivers import Mail, read_secret, whom_to_believe
from service.operations.notices.senders import MOST_BYTES, TIMEOUT_S, NotTakenError
from service.store.tables import NoticeRow


class _Smtp(smtplib.SMTP):
    """SMTP within an exchange."""

    def _get_socket(self, host: str, port: int, timeout: float) -> socket.socket:
        del timeout  # that of the exchange
        return connect(host, port)


class MailSender:
    """Sends mails in plain text."""

    def __init__(self, mail: Mail, source: str) -> None:
        self.name = mail.name
        self._mail = mail
        self._source = source
        self._tls = whom_to_believe(mail.ca_file)

    def send(self, notice: NoticeRow) -> None:
        """Hand over a notice to the mail server; raises NotTakenError if it does not take it."""
        mail = self._mail
        try:
            with exchange(TIMEOUT_S, MOST_BYTES), _Smtp(mail.host, mail.port) as server:
                if mail.start_tls:
                    server.starttls(context=self._tls)
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
